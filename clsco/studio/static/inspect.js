// What is known of the pixel under the cursor, and how the light of its source spreads.

import { RUNG } from "./protocol.js";
import { made, one, studio } from "./shared.js";

const IDLE = 400; // ms after an exact frame
const SOON = 0.1, REST = 150; // s up to which a response is measured unasked; ms of rest before that
const PLOTTED = 32; // px from the middle of a plot to its border

// ---- values under the cursor ------------------------------------------------------------------------------------
/** @type {[number, number] | null} */
let at = null; // null: the point in focus
let isPinned = false; // by a click
let asked = false, again = false, drag = 1e6, idle = 0;
const ask = () => {
  if (studio.isCanceled()) return;
  if (asked) { again = true; return; }
  asked = true;
  studio.send({ at });
};

const number = (value) => {
  if (Array.isArray(value)) return value.map(number).join(", ");
  return typeof value === "number" ? String(Number(value.toPrecision(6))) : String(value ?? "∞");
};

const ROWS = [
  ["codes", "Codes", ""], ["color", "Light, linear", ""], ["sharp", "Light, all in focus", ""], ["depth", "Depth Z", "mm"],
  ["blur_radius", "Blur radius R", "px"], ["sigma", "Standard deviation σ", "px"], ["normal", "Normal", ""],
  ["flow", "Flow to the next frame", "px"], ["object", "Object", ""], ["object_id", "Object number", ""],
  ["missing", "Missing before filling", ""], ["hidden", "Hidden in the reference pose", ""],
  ["flow_occluded", "Hidden in the next frame", ""], ["uv", "Place in the texture", ""],
  ["raw", "Codes of the sensor", "DN"], ["electrons", "Electrons without noise", "e−"],
  ["noise_sigma", "Standard deviation of the noise", "e−"], ["saturated", "Saturated", ""],
];

const row = (label, ...texts) => made("tr", {}, made("th", { scope: "row" }, label), ...texts.map((text) => made("td", {}, text)));

const inspected = ({ values, psf, unmeasured, seconds }) => {
  asked = false;
  studio.done();
  one("#pixel").textContent = `x ${values.x}, y ${values.y}`;
  one("#values").replaceChildren(...ROWS.filter(([name]) => name in values).map(([name, label, unit]) => {
    const text = typeof values[name] === "boolean" ? (values[name] ? "yes" : "no") : `${number(values[name])}${unit && ` ${unit}`}`;
    return row(label, text);
  }));
  shownAt = [values.x, values.y];
  model = psf;
  studio.describe(values);
  depth = values.depth;
  response = null;
  one("#psf-part").hidden = psf === undefined;
  spread();
  measurable(psf === undefined ? "no surface" : unmeasured, seconds);
  if (again) { again = false; ask(); }
};
studio.notInspected = () => { asked = false; };

const point = (pixel, pinned = false) => {
  [at, isPinned] = [pixel, pinned];
  clearTimeout(timer);
  ask();
};
studio.pin = (pixel) => { if (pixel || isPinned) point(pixel, pixel !== null); };
studio.isPinned = () => isPinned;

studio.hearing.push((said) => {
  const found = said.about?.point;
  if (found && at === null) { // it comes with an exact frame
    [model, shownAt] = [found.psf, [found.values.x, found.values.y]];
    studio.describe(found.values);
    spread();
  }
  if (said.inspected) inspected(said.inspected);
  if (said.measured) measured(said.measured);
});

// ---- the point spread function: that of the model, and as measured: a rendering with nothing else lit ------------
/** @typedef {{ reach: number, radius: number, plot: string }} Weights
 * @type {Weights | undefined} */
let model;
/** @type {Weights | null} */
let response = null;
/** @type {[number, number] | null} */
let shownAt = null;
let depth = null, timer = 0;

const measurable = (why, seconds) => {
  clearTimeout(timer);
  const button = one("#measure"), offers = why === undefined && seconds > SOON;
  button.hidden = !offers;
  if (offers) button.textContent = `Measure, about ${number(Number(seconds.toPrecision(2)))} s`;
  one("#unmeasured").textContent = why === undefined ? "" : `Not measured: ${why}`;
  if (why === undefined && !offers) timer = setTimeout(measure, REST);
};

const measure = () => {
  if (shownAt === null) return;
  one("#measure").hidden = true;
  studio.send({ measure: shownAt });
};

const measured = ({ x, y, response: found, unmeasured }) => {
  studio.done();
  if (shownAt === null || shownAt[0] !== x || shownAt[1] !== y) return;
  one("#unmeasured").textContent = unmeasured === undefined ? "" : `Not measured: ${unmeasured}`;
  response = found ?? null;
  spread();
};

const spread = () => {
  if (model === undefined) return;
  const weights = model;
  const side = 2 * Math.min(PLOTTED, Math.ceil(1.3 * Math.max(model.reach, response?.reach ?? 0)) + 2) + 1;
  plot(one("#psf"), model, side);
  plot(one("#response"), response, side);
  plot(one("#spot"), model, 2 * Math.min(PLOTTED, Math.ceil(1.25 * model.reach) + 2) + 1);
  one("#psf-side").textContent = `${side} × ${side} px about the source, each as bright as its largest weight`;
  const rows = [["Sum", "sum"], ["Centroid, px", "centroid"], ["RMS per axis, px", "rms"], ["Largest weight", "largest"]];
  one("#psf-values").replaceChildren(...rows.map(([label, name]) => row(label, rounded(weights[name]), rounded(response?.[name]))));
  const half = rounded(Math.abs(model.radius) / 2);
  one("#psf-about").textContent = `R ${number(model.radius)} px at Z ${number(depth)} mm; of a wide disc RMS is |R| / 2 = ${half} px`;
};

const rounded = (value) => (value === undefined ? "–" : Array.isArray(value) ? value.map(rounded).join(", ")
  : String(Number(value.toFixed(Math.abs(value) < 0.1 ? 5 : 3))));

const plot = (canvas, weights, seen) => { // the middle of what there is, `seen` pixels wide
  const context = canvas.getContext("2d");
  context.clearRect(0, 0, canvas.width, canvas.height);
  if (weights === null) return;
  const codes = Uint8Array.from(atob(weights.plot), (letter) => letter.charCodeAt(0));
  const data = new Uint8ClampedArray(4 * codes.length), side = Math.sqrt(codes.length), edge = (side - seen) / 2;
  codes.forEach((code, index) => data.set([code, code, code, 255], 4 * index));
  const whole = new OffscreenCanvas(side, side);
  whole.getContext("2d")?.putImageData(new ImageData(data, side, side), 0, 0);
  context.imageSmoothingEnabled = false;
  context.drawImage(whole, edge, edge, seen, seen, 0, 0, canvas.width, canvas.height);
};

studio.begin = () => {
  const stage = one("#stage");
  one("#measure").addEventListener("click", measure);
  stage.addEventListener("pointermove", (event) => {
    const found = studio.viewport.pixelAt(event.clientX, event.clientY);
    if (found === null || isPinned || (at !== null && at[0] === found[0] && at[1] === found[1])) return;
    point(found);
  });
  stage.addEventListener("pointerleave", () => { // but not on the way to the inspector
    if (!isPinned && at !== null && !one("#studio").classList.contains("sided")) point(null);
  });
  stage.addEventListener("pointerdown", (event) => { // a click has whole coordinates, which may be of another pixel
    const found = studio.tool === "focus" && event.button === 0 ? studio.viewport.pixelAt(event.clientX, event.clientY) : null;
    if (found === null) return;
    drag += 1;
    studio.send({ focus: found, drag });
    studio.take("");
  });
};
studio.rested = () => { // of the point; and, once nothing changes, of the whole frame
  ask();
  clearTimeout(idle);
  idle = setTimeout(() => { if (studio.rung === RUNG.EXACT && !studio.isCanceled()) studio.send({ overview: true }); }, IDLE);
};

const ARROWS = { ArrowRight: [4, 0], ArrowLeft: [-4, 0], ArrowDown: [0, 4], ArrowUp: [0, -4] }; // px
const steer = (event) => { // the point, by keys: false for other keys
  const by = ARROWS[event.key], from = at ?? shownAt, { width, height } = one("#canvas");
  if (!event.target.matches("body, #stage") || from === null || !(by || (event.key === "Enter" && isPinned))) return false;
  event.preventDefault();
  const to = (k, size) => Math.min(Math.max(from[k] + by[k] * (event.shiftKey ? 10 : 1), 0), size - 1);
  if (by) point([to(0, width), to(1, height)], true);
  else studio.send({ focus: at, drag: drag += 1 });
  return true;
};

const TOOLS = { f: "focus", m: "move" };
studio.extra = (event) => {
  const tool = TOOLS[event.key.toLowerCase()];
  if (!steer(event)) studio[tool ? "take" : "compares"](tool ?? event);
};

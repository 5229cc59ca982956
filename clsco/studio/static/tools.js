// What the pointer does in the picture besides moving it, and how the picture is shown: nothing here changes its codes.

import { MARK, all, on, one, stroked, studio, written } from "./shared.js";

// ---- tools ------------------------------------------------------------------------------------------------------
studio.take = (name) => { // a tool; the same once more, or "", puts it away
  studio.tool = studio.tool === name ? "" : name;
  one("#stage").dataset.tool = studio.tool;
  for (const button of all("button[data-tool]")) button.setAttribute("aria-pressed", String(button.dataset.tool === studio.tool));
  hint("");
};

// ---- objects are dragged ----------------------------------------------------------------------------------------
const FIRST = 2e6; // numbers of drags, which those of controls do not reach
let drag = FIRST;
/**
 * What is dragged: where the pointer took hold and is, whether by the handle along z, and whether the server knows of what.
 * @type {{ drag: number, from: [number, number], to: [number, number], along: boolean, rises: boolean, known: boolean, name?: string, ended?: boolean } | null}
 */
let held = null;
let frame = 0; // that the next change waits for
let under = ""; // the name of the object under the pointer

/** @type {[number, number] | null} */
let pointer = null; // where it is in the page

const hint = (text) => { // the name of what is held or would be, beside the pointer
  const label = one("#hint");
  label.textContent = text;
  label.hidden = !text;
  if (!text || pointer === null) return;
  const box = one("#stage").getBoundingClientRect();
  label.style.left = `${pointer[0] - box.left + 14}px`;
  label.style.top = `${pointer[1] - box.top + 14}px`;
};

const hover = () => hint(pointer !== null && studio.tool === "move" && studio.viewport.pixelAt(...pointer) !== null ? under : "");

const pull = () => {
  frame = 0;
  if (held === null || !held.known) return;
  const { scale } = studio.viewport;
  studio.send({
    pull: [(held.to[0] - held.from[0]) / scale, (held.to[1] - held.from[1]) / scale], along: held.along, drag: held.drag,
  });
};

studio.heldBy = () => { // px on the stage, and of the handle along z, by which an object is dragged
  const [across, down] = held === null ? [0, 0] : [held.to[0] - held.from[0], held.to[1] - held.from[1]];
  return held === null || held.along ? { across: [0, 0], along: down } : { across: [across, down], along: 0 };
};

const moving = () => {
  const stage = one("#stage");
  stage.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    const handle = studio.handleAt(event.clientX, event.clientY);
    const at = handle?.at ?? (studio.tool === "move" ? studio.viewport.pixelAt(event.clientX, event.clientY) : null);
    if (at === null) return;
    drag += 1;
    const place = /** @type {[number, number]} */ ([event.clientX, event.clientY]);
    const rises = Boolean(handle?.along);
    held = { drag, from: place, to: place, along: rises || event.shiftKey, rises, known: false };
    studio.send({ grab: at, drag });
  });
  stage.addEventListener("pointermove", (event) => {
    pointer = [event.clientX, event.clientY];
    if (held === null) { hover(); return; }
    held.to = pointer;
    held.along = held.rises || event.shiftKey;
    frame ||= requestAnimationFrame(pull);
    studio.viewport.changed();
    hint(held.name ?? "");
  });
  stage.addEventListener("pointerleave", () => {
    pointer = null;
    if (held === null) hint("");
  });
  const end = () => {
    if (held === null) return;
    if (frame) { cancelAnimationFrame(frame); pull(); }
    const { scale } = studio.viewport;
    studio.dropped(studio.heldBy().across.map((by) => by / scale));
    if (held.known) held = null;
    else held.ended = true; // once it is known what was held, it is moved
  };
  stage.addEventListener("pointerup", end);
  stage.addEventListener("pointercancel", end);
  on("keydown", (event) => { // before others; in a drag it takes that back alone
    if (event.key !== "Escape" || one("dialog[open]") || (held === null && !studio.tool)) return;
    if (held === null) { studio.take(""); return; }
    event.stopImmediatePropagation();
    held.to = held.from;
    held.along = false;
    pull();
    held = null;
  }, { capture: true });
};

studio.hearing.push((said) => {
  if (said.inspected) {
    under = said.inspected.values.object ?? "";
    if (held === null) hover();
  }
  if (!said.grabbed || held === null || said.grabbed.drag !== held.drag) return;
  if (said.grabbed.name === null) { held = null; return; }
  held.known = true;
  held.name = said.grabbed.name;
  hint(held.name);
  pull();
  if (held.ended) held = null;
});

// ---- exposure and gamma of the view -----------------------------------------------------------------------------
const expose = studio.expose = () => {
  const stops = Number(one("#exposure").value), gamma = Number(one("#gamma").value);
  const neutral = stops === 0 && gamma === 1;
  for (const part of all("#view-filter .stops > *")) part.setAttribute("slope", 2 ** stops);
  for (const part of all("#view-filter .gamma > *")) part.setAttribute("exponent", 1 / gamma);
  for (const canvas of all("#canvas, #pinned, #stacked")) canvas.style.filter = neutral || !shows() ? "" : "url(#view-filter)";
  one("#view-about").textContent = neutral ? "as it is" : `${stops > 0 ? "+" : ""}${stops} EV, gamma ${gamma}`;
  one("#shown").toggleAttribute("data-changed", !neutral);
};
const shows = () => studio.view === "color" || studio.view === "sharp";

// ---- the eyes of a stereo pair ----------------------------------------------------------------------------------
const turn = (right) => {
  studio.right = right;
  one("#eye").setAttribute("aria-pressed", String(right));
  studio.ask();
};

studio.hearing.push((said) => {
  if (!("pair" in said)) return;
  one("#eye").hidden = !said.pair;
  if (!said.pair && studio.right) turn(false);
});

// ---- arrows of motion -------------------------------------------------------------------------------------------
const RING = 16; // px, about what comes nearer or goes away

studio.arrows = [];
studio.overlays.push((context, place) => {
  if (!one("#arrows").checked) return;
  const lines = studio.arrows.flatMap((arrow) => {
    const from = place(arrow[0], arrow[1]), to = place(arrow[2], arrow[3]), nearer = arrow[4];
    const moves = Math.hypot(to[0] - from[0], to[1] - from[1]) > 1;
    return [...(moves ? across(from, to) : []), ...(nearer ? along(to, nearer > 0) : [])];
  });
  stroked(context, MARK, [6, 2.5], () => {
    for (const line of lines) line.forEach(([left, top], at) => { if (at) context.lineTo(left, top); else context.moveTo(left, top); });
  });
  studio.arrows.forEach(([, , x, y, nearer]) => {
    if (!nearer) return;
    const text = `${Number(Math.abs(nearer).toPrecision(3))} mm ${nearer > 0 ? "nearer" : "away"}`, [left, top] = place(x, y);
    context.font = "12px sans-serif";
    written(context, MARK, text, left + 2 * RING, top + 4);
  });
});

/** @typedef {[number, number][]} Line */
/** An arrow in the picture. @returns {Line[]} */
const across = (from, to) => {
  const angle = Math.atan2(to[1] - from[1], to[0] - from[0]);
  const barb = (turn) => [to[0] + 10 * Math.cos(angle + turn), to[1] + 10 * Math.sin(angle + turn)];
  return /** @type {Line[]} */ ([[from, to], [barb(2.6), to, barb(-2.6)]]);
};

/** A ring with barbs: outward about what comes nearer, and so grows, inward about what goes away. @returns {Line[]} */
const along = ([x, y], nears) => {
  const at = (turn, radius) => [x + radius * Math.cos(turn), y + radius * Math.sin(turn)], sign = nears ? 1 : -1;
  const ring = Array.from({ length: 25 }, (_, k) => at((k * Math.PI) / 12, RING - 6));
  const barbs = [0.25, 0.75, 1.25, 1.75].map((share) => share * Math.PI).map((turn) =>
    [at(turn - 0.35, RING - sign * 2), at(turn, RING + sign * 5), at(turn + 0.35, RING - sign * 2)]);
  return /** @type {Line[]} */ ([ring, ...barbs]);
};

studio.parts.push(() => {
  moving();
  for (const slider of all("#exposure, #gamma")) slider.addEventListener("input", expose);
  one("#neutral").addEventListener("click", () => {
    one("#exposure").value = 0;
    one("#gamma").value = 1;
    expose();
  });
  one("#eye").addEventListener("click", () => turn(!studio.right));
  one("#arrows").addEventListener("change", () => studio.viewport.changed());
  on("click", (_, target) => {
    const button = target.closest("button[data-tool]");
    if (button) studio.take(button.dataset.tool);
  });
});

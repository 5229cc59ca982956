// Comparing what is shown with a pinned frame: of before or as the thesis.

import { RUNG } from "./protocol.js";
import { brief } from "./scales.js";
import { all, made, on, one, reword, studio } from "./shared.js";
import { defaults } from "./views.js";

const FACTOR = 8; // of the difference
const WORDS = {
  eye: String, frame: (value) => `frame ${value + 1}`,
  "camera.f_number": (value) => `f/${brief(value)}`, "camera.focus_distance": (value) => `${brief(value)} mm`,
};

/** @typedef {Record<string, any>} Values of the scene, and eye and frame that are shown */
/** @type {{ image: HTMLCanvasElement, values: Values, view: string, words: string } | null} */
let pinned = null;
/** @type {Values | null} */
let asked = null; // of the scene whose frame as the thesis is awaited
let waits = false, differs = false, flipped = false; // waits: for the next exact frame
const shown = (values = studio.values) => ({ ...values, eye: studio.right ? "right eye" : "left eye", frame: studio.index });

const pin = () => { // the exact frame
  waits = studio.rung !== RUNG.EXACT;
  if (!waits) keep(one("#canvas"), studio.view, shown(), "pinned");
};

studio.pinned = (image, { full: [width, height], view }) => { if (asked) keep(image, view, shown(asked), "as the thesis", width, height); };

const keep = (source, view, values, words, width = source.width, height = source.height) => {
  const image = made("canvas", { width, height });
  image.getContext("2d")?.drawImage(source, 0, 0);
  [pinned, asked] = [{ image, values, view, words }, null];
  show();
};

const end = () => {
  [pinned, waits, asked, differs, flipped] = [null, false, null, false, false];
  show();
};

const show = () => {
  compare();
  studio.measure();
  studio.viewport.lay(one("#wipe"));
};

/** What the picture has where another differs: its eye, frame, f-number or focus, else another value; an empty box means its default. */
const named = (values, other) => {
  const normal = Object.fromEntries(defaults().flatMap(([, each]) => each)), meant = (of, path) => of[path] ?? normal[path] ?? 0;
  const differ = (path) => meant(values, path) !== meant(other, path);
  const words = Object.entries(WORDS).filter(([path]) => differ(path)).map(([path, word]) => word(values[path]));
  if (words.length) return words.join(", ");
  const box = all("#panels [data-path]").find(({ dataset }) => differ(dataset.path)); // of text, or a check box in its label
  if (!box || box.type === "radio") return box ? String(values[box.dataset.path]) : "";
  const value = meant(values, box.dataset.path), name = box.getAttribute("aria-label") ?? box.closest("label")?.textContent.trim();
  return `${name} ${value === true ? "on" : value === false ? "off" : brief(value)}`;
};
const tag = (place, words, detail) => {
  reword(place, detail ? `${words}: ${detail}` : words);
  place.hidden = false;
};

const compare = studio.compare = () => {
  if (waits && studio.rung === RUNG.EXACT) { pin(); return; }
  const over = one("#pinned"), [then, now] = [one("#then"), one("#now")], isOn = pinned !== null;
  one("#comparing").setAttribute("aria-pressed", String(isOn || waits));
  one("#compared").hidden = !isOn;
  one("[data-compare=flip]").setAttribute("aria-pressed", String(flipped));
  one("[data-compare=difference]").setAttribute("aria-pressed", String(differs));
  over.hidden = then.hidden = now.hidden = one("#wipe").hidden = true;
  if (pinned === null) return;
  const canvas = one("#canvas"), { image, values, view, words } = pinned, isSplit = !differs && !flipped;
  if (image.width !== canvas.width || image.height !== canvas.height || view !== studio.view) { tag(then, words, "another view or size"); return; }
  if (differs && !flipped && studio.rung !== RUNG.EXACT) { tag(then, "difference", "once it is exact"); return; } // a preview differs anyway
  over.hidden = false;
  one("#wipe").hidden = !isSplit;
  lay(over, image, isSplit);
  if (differs && !flipped) { tag(then, `difference × ${FACTOR}`, difference(canvas, over)); return; }
  tag(then, words, named(values, shown()));
  if (isSplit) tag(now, "now", named(shown(), values));
};

const lay = (over, image, isSplit) => { // over the picture, as far as the wipe leaves it
  if (over.width !== image.width) over.width = image.width;
  if (over.height !== image.height) over.height = image.height;
  over.getContext("2d").drawImage(image, 0, 0);
  over.style.clipPath = isSplit ? `inset(0 ${100 - one("#wipe").value}% 0 0)` : "";
};

const difference = (canvas, over) => { // shown in place of the pinned frame; gives it in words
  const size = [0, 0, canvas.width, canvas.height], context = over.getContext("2d");
  const now = canvas.getContext("2d").getImageData(...size).data, then = context.getImageData(...size), { data } = then;
  let largest = 0, count = 0;
  for (let index = 0; index < data.length; index += 4) {
    let most = 0;
    for (let at = index; at < index + 3; at += 1) {
      const step = Math.abs(now[at] - data[at]);
      most = Math.max(most, step);
      data[at] = FACTOR * step;
    }
    largest = Math.max(largest, most);
    count += Number(most > 0);
    data[index + 3] = 255;
  }
  context.putImageData(then, 0, 0);
  return count ? `at most ${largest} of 255, ${count} px` : "none";
};

const ACTIONS = {
  this: pin, thesis: () => { asked = { ...studio.values }; studio.send({ do: "pin thesis" }); },
  toggle: () => { if (pinned || waits) end(); else pin(); show(); },
  flip: () => { flipped = !flipped; show(); }, difference: () => { differs = pinned !== null && !differs; show(); },
};
const KEYS = { p: ACTIONS.toggle, d: ACTIONS.difference };
studio.compares = (event) => { // a key
  KEYS[event.key.toLowerCase()]?.();
  if (event.key !== " " || !event.target.matches("body, #stage") || event.repeat || flipped) return;
  event.preventDefault();
  ACTIONS.flip();
};

studio.parts.push(() => {
  on("keyup", (event, target) => { if (event.key === " " && flipped && target.matches("body, #stage")) ACTIONS.flip(); });
  on("click", (_, target) => { ACTIONS[target.closest("[data-compare]")?.dataset.compare]?.(); });
  one("#comparing").addEventListener("click", ACTIONS.toggle);
  one("#wipe").addEventListener("input", show);
});

// Comparing what is shown with a pinned frame: of before or as the thesis.

import { RUNG } from "./protocol.js";
import { MARK, made, on, one, studio, written } from "./shared.js";

const WHAT = { [RUNG.EXACT]: "pinned frame", [RUNG.PINNED]: "as the thesis" };

/** @type {{ image: HTMLCanvasElement, what: string, revision: number, view: string } | null} */
let pinned = null;
let mode = "off", flipped = false;

const pin = () => {
  if (studio.rung === RUNG.EXACT) keep(one("#canvas"), RUNG.EXACT, studio.revision, studio.view);
};

studio.pinned = (image, { full, rung, revision, view }) => {
  const [width, height] = full;
  keep(image, rung, revision, view, width, height);
};

const keep = (source, rung, revision, view, width = source.width, height = source.height) => {
  const image = made("canvas", { width, height });
  image.getContext("2d")?.drawImage(source, 0, 0);
  pinned = { image, what: WHAT[rung], revision, view };
  choose(mode === "off" ? "wipe" : mode);
};

const choose = (name) => {
  mode = pinned === null ? "off" : name;
  one("#compare").value = mode;
  compare();
  studio.measure();
  studio.viewport.changed();
};

const compare = () => {
  const over = one("#pinned"), badge = one("#pin-badge");
  one("#compare").disabled = pinned === null;
  if (pinned === null || (mode === "off" && !flipped)) {
    over.hidden = badge.hidden = one("#wipe").hidden = true;
    return;
  }
  const canvas = one("#canvas"), { image, what, revision, view } = pinned, factor = flipped ? 0 : Number(mode) || 0;
  const fits = image.width === canvas.width && image.height === canvas.height && view === studio.view;
  const waits = factor > 0 && studio.rung !== RUNG.EXACT; // a preview differs anyway
  const now = revision === studio.revision ? "" : ` (now ${studio.revision})`, of = `${what}, revision ${revision}${now}`;
  const about = factor ? `difference × ${factor} to ${of}` : of;
  badge.hidden = false;
  one("#wipe").hidden = !fits || mode !== "wipe";
  over.hidden = !fits || waits || (mode === "flip" && !flipped);
  if (over.hidden) {
    badge.textContent = !fits ? `${of}: of another view or size` : waits ? `${about}: once it is exact` : about;
    return;
  }
  lay(over, image);
  badge.textContent = factor ? `${about}: ${difference(canvas, over, factor)}` : about;
};

const lay = (over, image) => { // over the picture, as far as the wipe leaves it
  if (over.width !== image.width) over.width = image.width;
  if (over.height !== image.height) over.height = image.height;
  over.getContext("2d").drawImage(image, 0, 0);
  over.style.clipPath = mode === "wipe" && !flipped ? `inset(0 0 0 ${one("#wipe").value}%)` : "";
};

const difference = (canvas, over, factor) => { // shown in place of the pinned frame; gives it in words
  const size = [0, 0, canvas.width, canvas.height], context = over.getContext("2d");
  const now = canvas.getContext("2d").getImageData(...size).data, then = context.getImageData(...size), { data } = then;
  let largest = 0, count = 0;
  for (let index = 0; index < data.length; index += 4) {
    let most = 0;
    for (let at = index; at < index + 3; at += 1) {
      const found = Math.abs(now[at] - data[at]);
      most = Math.max(most, found);
      data[at] = factor * found;
    }
    largest = Math.max(largest, most);
    count += Number(most > 0);
    data[index + 3] = 255;
  }
  context.putImageData(then, 0, 0);
  return count ? `at most ${largest} of 255, ${count} px` : "none";
};

studio.overlays.push((context, place) => { // the line of the wipe, and what is on both sides of it
  if (mode !== "wipe" || flipped || one("#pinned").hidden) return;
  const [x] = place((one("#wipe").value / 100) * one("#canvas").width - 0.5, 0), { height } = context.canvas;
  for (const [width, color] of /** @type {[number, string][]} */ ([[4, "#141517"], [2, MARK]])) { // the first is its edge
    context.fillStyle = color;
    context.fillRect(Math.round(x) - width / 2, 0, width, height);
  }
  context.font = "12px system-ui, sans-serif";
  for (const [text, align, at] of /** @type {[string, CanvasTextAlign, number][]} */ ([["now", "right", x - 8], [pinned?.what ?? "", "left", x + 8]])) {
    context.textAlign = align;
    written(context, MARK, text, at, height - 44);
  }
});

studio.compare = compare;
studio.compares = (event) => { // a key
  if (event.key === "p" || event.key === "P") pin();
  if (event.key !== " " || event.target !== document.body || event.repeat) return;
  event.preventDefault();
  flip(true);
};

const flip = (isThere) => {
  flipped = isThere;
  compare();
  studio.measure();
};

studio.parts.push(() => {
  on("keyup", (event) => { if (event.key === " " && flipped) flip(false); });
  one("#pin").addEventListener("change", ({ target }) => {
    if (target.value === "this") pin();
    else studio.send({ do: `pin ${target.value}` });
    target.value = "";
  });
  one("#compare").addEventListener("change", (event) => choose(event.target.value));
  one("#wipe").addEventListener("input", () => { compare(); studio.viewport.changed(); });
});

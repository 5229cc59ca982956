// What the pointer does in the picture besides moving it, and how the picture is shown: nothing here changes its codes.

import { all, on, one, studio } from "./shared.js";


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
 * What is dragged: where the pointer took hold and is, and whether the server knows of what.
 * @type {{ drag: number, from: [number, number], to: [number, number], along: boolean, known: boolean, name?: string, ended?: boolean } | null}
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

const pulled = () => { frame ||= requestAnimationFrame(pull); };

const moving = () => {
  const stage = one("#stage");
  stage.addEventListener("pointerdown", (event) => {
    const at = event.button === 0 && studio.tool === "move" ? studio.viewport.pixelAt(event.clientX, event.clientY) : null;
    if (at === null) return;
    drag += 1;
    const place = /** @type {[number, number]} */ ([event.clientX, event.clientY]);
    held = { drag, from: place, to: place, along: event.shiftKey, known: false };
    studio.send({ grab: at, drag });
  });
  stage.addEventListener("pointermove", (event) => {
    pointer = [event.clientX, event.clientY];
    if (held === null) { hover(); return; }
    held.to = pointer;
    held.along = event.shiftKey;
    pulled();
    hint(held.name ?? "");
  });
  stage.addEventListener("pointerleave", () => {
    pointer = null;
    if (held === null) hint("");
  });
  const end = () => {
    if (held === null) return;
    if (frame) { cancelAnimationFrame(frame); pull(); }
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
const expose = () => {
  const stops = Number(one("#exposure").value), gamma = Number(one("#gamma").value);
  const neutral = stops === 0 && gamma === 1;
  for (const part of all("#view-filter .stops > *")) part.setAttribute("slope", 2 ** stops);
  for (const part of all("#view-filter .gamma > *")) part.setAttribute("exponent", 1 / gamma);
  for (const canvas of all("#canvas, #pinned, #stacked")) canvas.style.filter = neutral || !shows() ? "" : "url(#view-filter)";
  one("#view-about").textContent = neutral ? "as it is" : `${stops > 0 ? "+" : ""}${stops} EV, gamma ${gamma}`;
  one("#shown").toggleAttribute("data-changed", !neutral);
};
const shows = () => studio.view === "color" || studio.view === "sharp";
studio.expose = expose;

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
studio.arrows = [];
studio.overlays.push((context, place) => {
  if (!one("#arrows").checked) return;
  for (const [x0, y0, x1, y1] of studio.arrows) {
    const from = place(x0, y0), to = place(x1, y1), angle = Math.atan2(to[1] - from[1], to[0] - from[0]);
    /** @returns {[number, number]} */
    const barb = (turn) => [to[0] + 10 * Math.cos(angle + turn), to[1] + 10 * Math.sin(angle + turn)];
    for (const [width, color] of /** @type {[number, string][]} */ ([[6, "#141517"], [2.5, "#ffd24d"]])) { // the first is its edge, on light and dark
      [context.lineWidth, context.strokeStyle] = [width, color];
      context.beginPath();
      context.moveTo(...from);
      context.lineTo(...to);
      context.moveTo(...barb(2.6));
      context.lineTo(...to);
      context.lineTo(...barb(-2.6));
      context.stroke();
    }
  }
});

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

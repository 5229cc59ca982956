// A tour of two minutes: what is where, one part of the page after the other, with something to try.

import { all, made, on, one, studio } from "./shared.js";

/** @type {[string, string][]} */
const STEPS = [ // a part of the page, and words
  ["#lens-strip", "The lens. Drag the ruler, or type a distance; close the iris: the V of the blur gets flat, and more is sharp."],
  ["#focus", "Focus by click (F): press it, then click in the picture on what is to be sharp."],
  ["#badge", "What the picture is of: a preview while something is dragged, then exact: the pixels that clsco render writes of these values."],
  ["#views", "The truth beside the picture: depth, blur radius, flow and more of the same frame, also by the keys 1 to 9."],
  ["#stage", "Click an object: it is outlined, its handles move it, the one above along z. The wheel zooms, a double click fits."],
  ["#side", "The inspector: why it is soft at the pixel under the pointer. Its blur radius, how its light spreads, and the lens."],
  ["#panels-scroll", "The panels of the thesis, in its words, then those in use; chips add more. Input image takes a photo of your own; ↺ sets a default."],
  ["#comparing", "Compare what comes with this frame, or with that of the thesis, by a wipe; Space flips, D shows the difference."],
  ["#mode", "Inpaint: paint over what is to go, and have it filled by several methods."],
  ["#generate", "Generate writes frames, a clip, a focal stack or a data set, by a command line that can be copied. Share gives an address of this scene."],
];
const GAP = 10; // px between a part and the words about it

let at = -1;
/** @type {HTMLDialogElement | null} */
let dialog = null;

const button = (text, onclick, id = "") => made("button", { type: "button", id, onclick }, text);

const place = (box) => { // below the part or above it, wherever there is room; beside the whole of a tall one
  if (dialog === null) return;
  const { width, height } = dialog.getBoundingClientRect();
  const below = box.bottom + GAP + height < innerHeight, above = box.top - GAP - height > 0;
  const top = below ? box.bottom + GAP : above ? box.top - GAP - height : innerHeight - height - 6 * GAP;
  const left = Math.min(Math.max(box.left, GAP), innerWidth - width - GAP);
  dialog.style.top = `${top}px`;
  dialog.style.left = `${left}px`;
};

const show = (step) => {
  for (const marked of all("[data-toured]")) marked.removeAttribute("data-toured");
  if (step < 0 || step >= STEPS.length) { dialog?.close(); return; }
  at = step;
  const [selector, text] = STEPS[step], part = one(selector);
  studio.dock("sided", selector === "#side");
  if (innerWidth <= 900) studio.dock("open", Boolean(part.closest("#panels")));
  part.setAttribute("data-toured", "");
  one("#tour-words").textContent = text;
  one("#tour-at").textContent = `${step + 1} of ${STEPS.length}`;
  one("#tour-back").disabled = step === 0;
  one("#tour-next").textContent = step === STEPS.length - 1 ? "Done" : "Next";
  place(part.getBoundingClientRect());
};

/** @returns {HTMLDialogElement} */
const drawn = () => {
  const words = made("p", { id: "tour-words" }), next = button("Next", () => show(at + 1), "tour-next");
  words.setAttribute("aria-live", "polite");
  next.className = "primary";
  const count = made("span", { id: "tour-at", className: "spread" }), back = button("Back", () => show(at - 1), "tour-back");
  const tour = made("dialog", { id: "tour" }, words, made("div", { className: "row" }, count, back, next, button("Close", () => show(-1))));
  tour.setAttribute("aria-label", "Tour");
  tour.addEventListener("close", () => { show(-1); });
  one("#studio").append(tour);
  return tour;
};

studio.parts.push(() => {
  const keys = one("#keys");
  keys.append(button("Tour of the studio", () => {
    keys.close();
    dialog ??= drawn();
    if (!dialog.open) dialog.show(); // not as a modal: what is shown can be tried
    show(0);
    one("#tour-next").focus();
  }));
  on("keydown", (event) => {
    if (event.key === "Escape" && dialog?.open && !one("dialog:modal")) { event.stopImmediatePropagation(); show(-1); }
  }, { capture: true });
});

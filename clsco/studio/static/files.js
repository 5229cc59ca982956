// Scenes as files: the name in the header with a mark for what is not saved, lists of pictures, and Enter in dialogs.

import { all, on, one, reword, studio } from "./shared.js";

studio.hearing.push((said) => {
  if (!("saved" in said)) return;
  const name = said.file || "no file yet", place = one("#file");
  const title = said.title ? `${said.title} · clsco studio` : "clsco studio", shown = said.saved ? title : `● ${title}`;
  reword(one("#title"), said.title || "untitled");
  reword(place, said.saved ? name : `${name} ●`);
  place.title = said.saved ? "As it is saved" : "Changed since it was saved";
  place.setAttribute("aria-label", said.saved ? name : `${name}, not saved`);
  if (document.title !== shown) document.title = shown;
});

/** Leaves what has all words, in its name or its group's. */
const search = (box) => {
  const words = box.value.toLowerCase().split(/\s+/), dialog = box.closest("dialog");
  let found = 0;
  for (const group of dialog.querySelectorAll("[data-group]")) {
    let here = 0;
    for (const item of group.querySelectorAll("li")) {
      const text = `${item.textContent.toLowerCase()} ${group.dataset.group}`;
      item.hidden = !words.every((word) => text.includes(word));
      here += Number(!item.hidden);
    }
    group.hidden = here === 0;
    found += here;
  }
  dialog.querySelector("[data-nothing]").hidden = found > 0;
};

on("input", (_, target) => { if (target.matches?.("[data-search]")) search(target); });
on("close", (_, target) => { // which does not bubble
  for (const box of target.querySelectorAll?.("[data-search]") ?? []) box.value = "";
}, { capture: true });

/** What Enter in a box of a dialog does: the first scene that is left, or what the dialog is for. */
const meant = (box) => box.matches("[data-search]")
  ? all("dialog[open] .tiles li:not([hidden]) button").find((each) => each.offsetParent !== null)
  : box.closest("dialog").querySelector("button.primary:not([disabled])");

on("keydown", (event, target) => {
  const is = event.key === "Enter" && !event.isComposing && target.matches?.("dialog[open] :is([type=text], [type=search])");
  if (!is || target.dataset.path || target.dataset.kind) return;
  event.preventDefault();
  meant(target)?.click();
});

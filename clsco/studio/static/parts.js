// Parts of the page that Python draws again, and elements that do something there.

import { all, on, one, problem, studio } from "./shared.js";

const AFTER = { // what is waited for before an element does something, and what may be its value
  shownFrame: () => studio.brush.shownFrame(),
  sent: () => studio.brush.sent(),
  uploaded: (element) => studio.uploaded(element.files[0]),
};

const valueOf = (element) => element.type === "checkbox" ? element.checked : element.open ?? element.value;

for (const kind of /** @type {const} */ (["click", "input", "change", "toggle"])) {
  on(kind, async (/** @type {any} */ event, target) => {
    const element = target.closest?.(`[data-on="${kind}"]`);
    if (!element || (event.detail > 1 && element.matches(".primary"))) return; // a double click begins no second job
    const number = Number(element.dataset.number), value = valueOf(element);
    studio.flush();
    const after = AFTER[element.dataset.after]?.(element);
    if ("once" in element.dataset) element.value = "";
    try {
      studio.send({ on: number, value: (await after) ?? value });
    } catch (error) { studio.fail([problem(error)]); }
  }, { capture: true });
}

studio.hearing.push((said) => {
  if ("part" in said) for (const place of all(`[data-part="${said.part}"]`)) place.innerHTML = said.html;
  if (said.show && !one(said.show).open) one(said.show).showModal();
  if (said.close) one(said.close).close();
  if (said.notice) studio.notify(said.notice, said.good);
  if (said.brush) studio.brush[said.brush[0]](...said.brush.slice(1));
});

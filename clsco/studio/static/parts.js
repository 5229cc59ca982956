// Parts of the page that Python draws again, and elements that do something there.

import { all, on, one, studio } from "./shared.js";

const AFTER = { // what is waited for before an element does something, and what may be its value
  shownFrame: () => studio.brush.shownFrame(),
  sent: () => studio.brush.sent(),
};

const valueOf = (element) => element.type === "checkbox" ? element.checked : element.open ?? element.value;

for (const kind of /** @type {const} */ (["click", "input", "change", "toggle"])) {
  on(kind, async (_, target) => {
    const element = target.closest?.(`[data-on="${kind}"]`);
    if (!element) return;
    const number = Number(element.dataset.number), value = valueOf(element);
    if ("once" in element.dataset) element.value = "";
    studio.flush();
    studio.send({ on: number, value: (await AFTER[element.dataset.after]?.()) ?? value });
  }, { capture: true });
}

studio.hearing.push((said) => {
  if ("part" in said) for (const place of all(`[data-part="${said.part}"]`)) place.innerHTML = said.html;
  if (said.show && !one(said.show).open) one(said.show).showModal();
  if (said.close) one(said.close).close();
  if (said.notice) studio.notify(said.notice, said.good);
  if (said.brush) studio.brush[said.brush[0]](...said.brush.slice(1));
});

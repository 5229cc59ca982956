// What takes long: how far it is, what it waits for, and its end by Esc.

import { RUNG } from "./protocol.js";
import { all, one, reword, studio } from "./shared.js";

const STILL = 10; // s without progress, after which it is said what is waited for
const PACE = 2000; // ms between words, as they are read out

let said = -Infinity, canceled = false;

const progressed = ({ doing, done, total, still }) => {
  if (canceled) return; // it was said before
  if (performance.now() - said < PACE && !one("#progress").hidden) return;
  said = performance.now();
  const step = total > 1 ? ` ${Math.min(done + 1, total)} of ${total}` : "", isCompiling = doing.startsWith("compiling");
  const words = [isCompiling ? `Compiling${step}` : step ? `Time sample${step}` : "Rendering"];
  if (!isCompiling && (doing === "another tab" || still >= STILL)) words.push(`waits for ${doing}`);
  if (still >= STILL) words.push(`no progress for ${Math.round(still)} s`);
  one("#progress").textContent = `${words.join(", ")} · Esc cancels`;
  one("#progress").hidden = false;
};

studio.done = () => { // something is there
  canceled = false;
  one("#progress").hidden = true;
};

const stopped = () => {
  studio.notInspected();
  canceled = studio.rung !== RUNG.EXACT;
  one("#progress").hidden = !canceled;
  if (canceled) one("#progress").textContent = "Canceled: the exact frame comes with the next change";
};
studio.isCanceled = () => canceled;

let timed = { took: 0, revision: -1 }, revision = 0; // timed: s of an exact frame, and of which scene
const time = (seconds) => {
  const [unit, size] = seconds < 100 ? ["s", 1] : seconds < 6000 ? ["min", 60] : ["h", 3600];
  return `${Number((seconds / size).toPrecision(2))} ${unit}`;
};
const predicted = () => { // what Generate is about to take
  const place = one("[data-took]"), button = one("#making .primary"), count = Number(place.dataset.took), isKnown = timed.revision === revision;
  button.disabled = count > 0 && Object.keys(studio.faults).length > 0;
  const cost = isKnown ? `about ${time(timed.took * count)}` : "cost not known yet";
  reword(place, button.disabled ? `; invalid: ${one("#fault").textContent}` : count ? `, ${cost}` : "");
  reword(button, `Generate ${place.dataset.amount}`);
};

studio.parts.push(predicted);
let spoken = 0;
const speak = () => { // how far jobs are, not too often
  if (performance.now() - spoken < PACE) return;
  spoken = performance.now();
  const words = (job) => `${job.getAttribute("aria-label")} ${job.querySelector("small").textContent}`;
  reword(one("#spoken"), all(".job:is(.waiting, .running)").map(words).join("; "));
};

studio.hearing.push((said) => {
  if (said.progress) progressed(said.progress);
  if (said.about?.took && said.about.is_whole) timed = said.about;
  if ("undo" in said) revision = said.revision;
  if (said.about || said.part || said.faults) predicted();
  if (said.part) speak();
  if (said.stopped) stopped();
});

studio.escape = () => {
  if (document.querySelector("dialog[open]")) return;
  if (one("#studio").classList.contains("making")) studio.dock("making", false);
  else if (!one("#progress").hidden && !canceled) studio.send({ do: "cancel" });
};

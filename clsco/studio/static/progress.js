// What takes long: how far it is, what it waits for, and its end by Esc.

import { RUNG } from "./protocol.js";
import { one, studio } from "./shared.js";

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

studio.hearing.push((said) => {
  if (said.progress) progressed(said.progress);
  if (said.stopped) stopped();
});

studio.escape = () => {
  if (document.querySelector("dialog[open]")) return;
  if (!one("#progress").hidden && !canceled) studio.send({ do: "cancel" });
};

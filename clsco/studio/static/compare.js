// Comparing what is shown with a pinned frame: of before, as the thesis, or by the reference.

import { RUNG } from "./protocol.js";
import { one, studio } from "./shared.js";

const WHAT = { [RUNG.EXACT]: "pinned frame", [RUNG.PINNED]: "as the thesis", [RUNG.REFERENCE]: "reference" };

let pinned = null, mode = "off", flipped = false; // pinned: { image, what, revision, view }
const pin = () => {
  if (studio.rung === RUNG.EXACT) keep(one("#canvas"), RUNG.EXACT, studio.revision, studio.view);
};

studio.pinned = (image, { full, rung, revision, view }) => {
  const whole = document.createElement("canvas");
  [whole.width, whole.height] = full;
  whole.getContext("2d").drawImage(image, 0, 0);
  keep(whole, rung, revision, view);
};

const keep = (source, rung, revision, view) => {
  const image = document.createElement("canvas");
  [image.width, image.height] = [source.width, source.height];
  image.getContext("2d").drawImage(source, 0, 0);
  pinned = { image, what: WHAT[rung], revision, view };
  choose(mode === "off" ? "wipe" : mode);
};

const choose = (name) => {
  mode = pinned === null ? "off" : name;
  one("#compare").value = mode;
  compare();
};

const compare = () => {
  const over = one("#pinned"), canvas = one("#canvas"), badge = one("#pin-badge");
  const wanted = pinned !== null && (mode !== "off" || flipped), factor = flipped ? 0 : Number(mode) || 0;
  const fits = wanted && pinned.image.width === canvas.width && pinned.image.height === canvas.height
    && pinned.view === studio.view;
  const waits = factor > 0 && studio.rung !== RUNG.EXACT; // a preview differs anyway
  over.hidden = !fits || waits || (mode === "flip" && !flipped);
  one("#wipe").hidden = !fits || mode !== "wipe";
  one("#compare").disabled = pinned === null;
  badge.hidden = !wanted;
  if (!wanted) return;
  const now = pinned.revision === studio.revision ? "" : ` (now ${studio.revision})`;
  const of = `${pinned.what}, revision ${pinned.revision}${now}`;
  badge.textContent = !fits ? `${of}: of another view or size` : waits ? `difference × ${factor} to ${of}: once it is exact` : of;
  if (over.hidden) return;
  if (over.width !== canvas.width) over.width = canvas.width;
  if (over.height !== canvas.height) over.height = canvas.height;
  over.getContext("2d").drawImage(pinned.image, 0, 0);
  over.style.clipPath = mode === "wipe" && !flipped ? `inset(0 0 0 ${one("#wipe").value}%)` : "";
  if (factor) badge.textContent = `difference × ${factor} to ${of}: ${difference(canvas, over, factor)}`;
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
    count += most > 0;
    data[index + 3] = 255;
  }
  context.putImageData(then, 0, 0);
  return count ? `at most ${largest} of 255, ${count} px` : "none";
};

// ---- what the reference is at -------------------------------------------------------------------------------------
let started = 0, clock = 0, run = null; // run: { revision[, seconds] }
studio.referring = (said) => {
  if (said !== null && run?.revision !== said.revision) started = performance.now();
  run = said;
  one("#reference").hidden = run === null;
  clearInterval(clock);
  if (run === null) return;
  clock = setInterval(tick, 2000); // no more often, as it is read out
  tick();
};

const tick = () => {
  const about = run.seconds === undefined ? "" : ` of about ${Math.max(1, Math.round(run.seconds))} s`;
  one("#reference-about").textContent = `The reference renders revision ${run.revision}: ${Math.round((performance.now() - started) / 1000)} s${about}`;
};

studio.isReferring = () => run !== null;
studio.compare = compare;
studio.compares = (event) => { // a key
  if (event.key === "p" || event.key === "P") pin();
  if (event.key !== " " || event.target !== document.body || event.repeat) return;
  event.preventDefault();
  flipped = true;
  compare();
};

studio.hearing.push((said) => { if ("reference" in said) studio.referring(said.reference); });
studio.parts.push(() => {
  document.addEventListener("keyup", (event) => { if (event.key === " ") { flipped = false; compare(); } });
  one("#pin").addEventListener("change", ({ target }) => {
    if (target.value === "this") pin();
    else studio.send({ do: `pin ${target.value}` });
    target.value = "";
  });
  one("#compare").addEventListener("change", (event) => choose(event.target.value));
  one("#wipe").addEventListener("input", compare);
  one("#reference-cancel").addEventListener("click", () => studio.referring(null));
});

// The time line: frames, the time samples of each, playing; and the focal stack, which is a line of focus distances.

import { all, made, one, reword, studio, toggles } from "./shared.js";

const KEPT = 256 * 2 ** 20; // bytes of frames that are kept for playing, and of a focal stack
const digits = (value) => Number(value.toPrecision(6));

// ---- frames -----------------------------------------------------------------------------------------------------
let frames = 1, interval = 1, revision = 0;
studio.seek = (index) => {
  studio.index = Math.min(Math.max(index, 0), frames - 1);
  studio.moment = null;
  ask();
};

studio.seekTime = (time) => { // one moment; what is before or after the sequence is not shown
  studio.index = Math.min(Math.max(Math.floor(time / interval), 0), frames - 1);
  studio.moment = Math.min(Math.max(time, 0), frames * interval);
  play(false);
  ask();
};
studio.time = () => studio.moment ?? studio.index * interval;
studio.length = () => frames * interval;

studio.wanted = () => ({ frame: studio.index, time: studio.moment, eye: studio.right ? "right" : "left" });

const ask = studio.ask = () => {
  studio.rung = -1;
  forget();
  if (studio.moment === null) one("#exposed").replaceChildren(); // those of another frame, until its own are told
  studio.send(studio.wanted());
  line();
  studio.badge();
};

const line = () => {
  studio.index = Math.min(studio.index, frames - 1);
  const slider = one("#frame");
  slider.max = frames - 1;
  slider.value = studio.index;
  slider.disabled = one("#play").disabled = frames < 2;
  reword(one("#time"), `frame ${studio.index + 1} of ${frames}, ${studio.moment === null ? "" : "at "}t = ${digits(studio.time())} s`);
  one("#whole").hidden = studio.moment === null;
  studio.timed();
  for (const tick of all("#exposed button")) {
    tick.setAttribute("aria-pressed", String(Number(tick.dataset.time) === studio.moment));
  }
  if (frames < 2) play(false);
  one("#line").hidden = frames < 2 && !studio.values.moves && one("#keyframes-part").hidden;
};

// ---- the exposure: its time samples as ticks, the open shutter as a band ----------------------------------------
const exposure = ({ times, shutter, arrows }) => {
  if (studio.moment !== null) return; // ticks and arrows are those of the whole frame
  studio.arrows = arrows;
  studio.viewport.changed();
  one("#exposure-row").hidden = shutter === null;
  if (shutter === null) return;
  const begin = Math.min(studio.index * interval, shutter[0]); // the interval, and what of the shutter is beyond
  const length = Math.max((studio.index + 1) * interval, shutter[1]) - begin;
  const share = (time) => `${(100 * (time - begin)) / length}%`;
  const band = one("#band"), ticks = one("#exposed");
  band.style.left = share(shutter[0]);
  band.style.width = `${(100 * (shutter[1] - shutter[0])) / length}%`;
  one("#exposure-about").textContent = `${times.length} time sample${times.length === 1 ? "" : "s"}, shutter open `
    + `${digits(shutter[1] - shutter[0])} of ${digits(interval)} s`;
  ticks.replaceChildren(...times.map((time, number) => {
    const tick = made("button", { type: "button", title: `Time sample ${number + 1} alone, t = ${digits(time)} s` });
    tick.dataset.time = time;
    tick.style.left = share(time);
    tick.setAttribute("aria-label", tick.title);
    tick.setAttribute("aria-pressed", "false");
    return tick;
  }));
};

const chosen = (event) => { // a time sample; once more: the whole frame again
  const tick = event.target.closest("button");
  if (tick === null) return;
  play(false);
  const time = Number(tick.dataset.time);
  studio.moment = studio.moment === time ? null : time;
  ask();
};

// ---- playing: frames that came are kept while the scene is what it is -------------------------------------------
let kept = new Map(), of = ""; // pictures by the number of the frame; the revision and view that they are of
studio.drawn = (picture) => {
  if (picture.revision !== revision) {
    revision = picture.revision;
    forget();
  }
  if (frames < 2 || picture.number >= frames) return;
  const { width, height } = one("#canvas"), key = `${picture.revision} ${picture.view} ${picture.right}`;
  if (key !== of) {
    for (const [, image] of kept) image.then((each) => each.close());
    [kept, of] = [new Map(), key];
  }
  if (4 * width * height * (kept.size + 1) > KEPT && !kept.has(picture.number)) return;
  kept.get(picture.number)?.then((each) => each.close());
  kept.set(picture.number, createImageBitmap(one("#canvas")));
};

let player = 0;
const still = matchMedia("(prefers-reduced-motion: reduce)"); // then it is played once

const step = async () => {
  const next = (studio.index + 1) % frames;
  if (next === 0 && still.matches) { play(false); return; }
  if (of !== `${studio.revision} ${studio.view} ${studio.right}` || !kept.has(next)) { studio.seek(next); return; }
  [studio.index, studio.moment] = [next, null];
  studio.rung = -1;
  const image = await kept.get(next);
  if (!player || studio.index !== next) return;
  one("#canvas").getContext("2d").drawImage(image, 0, 0);
  studio.played();
  line();
};

const play = (on) => {
  if (!on && player) studio.send({ ...studio.wanted(), again: true }); // to be seen as it is
  clearInterval(player);
  player = on ? setInterval(step, Math.max(1000 * interval, 40)) : 0;
  one("#play").setAttribute("aria-pressed", String(Boolean(player)));
  reword(one("#play"), player ? "❚❚" : "▶");
};

// ---- the focal stack --------------------------------------------------------------------------------------------
let distances = [], stack = [];
const forget = studio.unstack = () => {
  if (!distances.length) return;
  for (const image of stack) image?.close();
  [distances, stack] = [[], []];
  one("#stacked").hidden = true;
  studio.measure();
  turn();
};

studio.stacked = (picture, image) => {
  if (picture.revision !== studio.revision || picture.number >= distances.length) { image.close(); return; }
  stack[picture.number] = image;
  if (stack.filter(Boolean).length === 1) one("#step").value = picture.number;
  turn();
};

const turn = () => { // to the picture that the slider points at, or the nearest that is there
  const count = stack.filter(Boolean).length, slider = one("#step");
  slider.disabled = one("#refocus").disabled = count === 0;
  one("#stack-about").textContent = distances.length === 0 ? "" : count < distances.length
    ? `${count} of ${distances.length} rendered` : `${distances.length} frames`;
  const here = Number(slider.value);
  if (stack[here] === undefined) return;
  const canvas = one("#stacked"), image = stack[here];
  [canvas.width, canvas.height, canvas.hidden] = [image.width, image.height, false];
  canvas.getContext("2d").drawImage(image, 0, 0);
  one("#step-about").textContent = `focus ${digits(distances[here])} mm`;
  studio.measure();
};

const begin = () => {
  const { width, height } = one("#canvas"), steps = Number(one("#stack-steps").value);
  if (4 * width * height * steps > KEPT) {
    studio.fail([`focal stack: must have at most ${Math.floor(KEPT / (4 * width * height))} frames of this size; got ${steps}`]);
    return;
  }
  forget();
  studio.send({ stack: [Number(one("#stack-nearest").value), Number(one("#stack-farthest").value), steps] });
};

studio.hearing.push((said) => {
  for (const [name, value] of Object.entries(said.overview?.ends ?? {})) one(`#stack-${name}`).defaultValue = value; // unless it was typed
  if ("frames" in said) {
    [frames, interval] = [said.frames, said.interval];
    line();
  }
  if (said.about) exposure(said.about);
  if (said.stack) {
    distances = said.stack;
    one("#step").max = distances.length - 1;
    one("#step").value = 0;
    turn();
  }
});

studio.parts.push(() => {
  one("#frame").addEventListener("input", (event) => studio.seek(Number(event.target.value)));
  one("#play").addEventListener("click", () => play(!player));
  one("#whole").addEventListener("click", () => studio.seek(studio.index));
  one("#exposed").addEventListener("click", chosen);
  one("#step").addEventListener("input", turn);
  one("#render-stack").addEventListener("click", begin);
  one("#refocus").addEventListener("click", () => studio.set("camera.focus_distance", digits(distances[Number(one("#step").value)])));
  toggles("#stack", "#stack-row", forget);
  line();
});

// Keyframes as marks on lines of time: sliders of the keys' times, one upon the other, so that a mark is dragged, stepped
// and taken back as all that has an attribute data-path.

import { all, made, one, reword, studio, toggles } from "./shared.js";

const MARK = 14; // px, the width of a mark
const NAMES = 200; // tracks that can be chosen
const digits = (value) => Number(value.toPrecision(9));

let tracks = [], axis = [0, 1], step = 0.001, drawn = "", chosen = ""; // chosen: the path of a keyframe
/** @type {[string, number] | null} */
let after = null; // the path of the track and the number of the keyframe that is chosen once it is there

// ---- the axis: the sequence, and what keyframes there are besides -----------------------------------------------
const measure = () => {
  const times = tracks.flatMap((track) => track.times).filter((time) => time !== null);
  axis = [Math.min(0, ...times), Math.max(studio.length(), ...times)];
  const power = 10 ** Math.floor(Math.log10((axis[1] - axis[0]) / 1000));
  step = power * ([1, 2, 5].find((factor) => factor * power >= (axis[1] - axis[0]) / 1001) ?? 10);
};

const share = (time) => (Math.min(Math.max(time, axis[0]), axis[1]) - axis[0]) / (axis[1] - axis[0]);

const scale = () => { // gives marks the axis; not while one is held
  if (one("#lanes input:active") === null) measure();
  const lanes = one("#lanes");
  lanes.style.setProperty("--begin", share(0));
  lanes.style.setProperty("--end", share(studio.length()));
  for (const mark of all("#lanes input")) {
    [mark.min, mark.max, mark.step] = [axis[0], axis[1], step];
    const time = tracks[mark.dataset.track].times[mark.dataset.number];
    if (mark !== document.activeElement && time !== null) mark.value = time; // else it has its own from studio.js
    mark.setAttribute("aria-valuetext", `${time} s`);
  }
  studio.timed();
};

// ---- lanes ------------------------------------------------------------------------------------------------------
const draw = () => {
  const select = one("#track"), before = select.value;
  select.replaceChildren(...tracks.slice(0, NAMES).map((track) => new Option(track.name, track.path)));
  if (tracks.some((track) => track.path === before)) select.value = before;
  const focused = one(":focus")?.dataset.path;
  one("#lanes").replaceChildren(...tracks.flatMap((track, number) => (track.times.length ? lane(track, number) : [])));
  if (focused) mark(focused)?.focus();
};

const lane = (track, number) => {
  const line = made("div", { className: "lane" }, ...track.times.map((time, key) => {
    const input = made("input", { type: "range", disabled: time === null });
    Object.assign(input.dataset, { path: `${track.path}.${key}.time`, track: number, number: key });
    input.setAttribute("aria-label", `Time of keyframe ${key + 1} of ${track.name}`);
    return input;
  }));
  line.dataset.track = track.path;
  return [made("span", { title: track.name }, track.name), line];
};

const mark = (path) => one(`#lanes [data-path="${CSS.escape(path)}"]`);

const choose = (path) => {
  chosen = mark(path) === null ? "" : path;
  for (const each of all("#lanes input")) each.toggleAttribute("data-chosen", each.dataset.path === chosen);
  one("#remove-key").disabled = one("#edit-key").disabled = !chosen;
  if (chosen) one("#track").value = mark(chosen).parentElement.dataset.track;
  about();
};

const about = () => {
  const place = one("#keyframes-about"), fault = studio.faults[chosen];
  place.toggleAttribute("data-wrong", fault !== undefined);
  reword(place, fault ?? (chosen ? `keyframe ${Number(mark(chosen).dataset.number) + 1}, t = ${digits(Number(mark(chosen).value))} s`
    : tracks.some((track) => track.times.length) ? "" : "no keyframes yet"));
};

// ---- the time that there is -------------------------------------------------------------------------------------
studio.timed = () => {
  one("#lanes").style.setProperty("--now", share(studio.time()));
  if (document.activeElement !== one("#key-time")) one("#key-time").value = digits(studio.time());
};

const typed = () => {
  const time = Number(one("#key-time").value.trim() || NaN);
  if (Number.isFinite(time)) return time;
  studio.fail([`keyframe: time must be a number of seconds; got "${one("#key-time").value}"`]);
  return null;
};

const seek = (event) => { // to a place of a lane beside the marks
  if (!event.target.classList.contains("lane")) return;
  const box = event.target.getBoundingClientRect();
  const at = Math.min(Math.max((event.clientX - box.left - MARK / 2) / (box.width - MARK), 0), 1);
  one("#track").value = event.target.dataset.track;
  choose("");
  studio.seekTime(digits(Math.round((axis[0] + at * (axis[1] - axis[0])) / step) * step));
};

// ---- what is done with them -------------------------------------------------------------------------------------
const add = () => {
  const path = one("#track").value, time = typed();
  if (time === null) return;
  const earlier = tracks.find((track) => track.path === path).times.filter((each) => each !== null && each < time);
  after = [path, earlier.length];
  studio.send({ keyframe: path, add: time });
};

const remove = () => {
  if (!chosen) return;
  const { track, number } = mark(chosen).dataset, path = tracks[track].path;
  after = [path, Math.max(Number(number) - 1, 0)];
  studio.send({ keyframe: path, remove: Number(number) });
};

const edit = async () => { // opens the boxes of a keyframe, of an object those of that object
  if (!chosen) return;
  const object = /^object\.(\d+)\./.exec(chosen), place = `#panels input[data-kind="number"][data-path="${CSS.escape(chosen)}"]`;
  one("#studio").classList.add("open");
  if (object && one(place) === null) one(`.objects li:nth-child(${Number(object[1]) + 1}) button`)?.click();
  for (let tries = 0; one(place) === null && tries < 60; tries += 1) await new Promise((done) => setTimeout(done, 50));
  const box = one(place);
  if (box === null) return;
  box.closest("details").open = true;
  box.scrollIntoView({ block: "center" });
  box.focus();
};

const pressed = (event) => {
  if (!event.target.matches("input[type=range]")) return;
  const does = { Delete: remove, Backspace: remove, Enter: edit }[event.key];
  if (does === undefined || event.ctrlKey || event.metaKey) return;
  event.preventDefault();
  does();
};

studio.hearing.push((said) => {
  if (said.tracks) {
    tracks = said.tracks;
    const now = JSON.stringify(tracks.map(({ path, name, times }) => [path, name, times.map((time) => time === null)]));
    if (now !== drawn) draw();
    drawn = now;
  }
  if (said.tracks || "frames" in said) scale();
  if (said.tracks && after !== null) {
    const path = `${after[0]}.${after[1]}.time`;
    after = null;
    mark(path)?.focus();
    choose(path);
  } else if (said.tracks) choose(chosen);
  if (said.error) after = null;
  if (said.faults) about();
});

studio.parts.push(() => {
  const lanes = one("#lanes");
  lanes.addEventListener("focusin", (event) => choose(event.target.dataset.path));
  lanes.addEventListener("pointerdown", seek);
  lanes.addEventListener("input", about);
  lanes.addEventListener("change", scale);
  lanes.addEventListener("keydown", pressed);
  one("#add-key").addEventListener("click", add);
  one("#remove-key").addEventListener("click", remove);
  one("#edit-key").addEventListener("click", edit);
  one("#key-time").addEventListener("keydown", (event) => {
    const time = event.key === "Enter" ? typed() : null;
    if (time !== null) studio.seekTime(time);
  });
  toggles("#keyframes", "#keyframes-part");
});

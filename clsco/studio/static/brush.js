// The brush of inpainting: a mask is painted over an image, and goes to the server as runs.

import { on, one, problem, studio } from "./shared.js";
import { Viewport } from "./viewport.js";

const TYPING = "input[type=text], input[type=number], select, textarea";
const STEPS = 50; // of undo
const MOST_KEPT = 2 ** 22; // runs of all masks that undo may come back to
const part = (name) => one(`[data-brush="${name}"]`);
const place = (what, rest = "") => `inpainting/${what}?tab=${encodeURIComponent(studio.tab)}${rest}`;
const isOpen = () => Boolean(part("canvas")?.closest("dialog").open);

/** @type {HTMLImageElement | null} */
let image = null;
let tool = "brush";
let mask = new Uint8Array(0), columns = 0, rows = 0;
const overlay = document.createElement("canvas"); // the mask as it is seen, over the image
/** @type {number[][]} masks as runs */
let past = [], future = [];
/** @type {[number, number] | null} */
let pointer = null; // pixel of the image under the pointer
/** @type {[number, number][] | null} */
let path = null; // pixels that a stroke went through
/** @type {number[] | null} */
let before = null; // runs of the mask when it began
let wantsFrame = false; // B takes the frame that is shown, where no image is open

const say = (text) => { part("told").textContent = text; };

// ---- the mask ---------------------------------------------------------------------------------------------------
const runsOf = () => {
  const found = [];
  let at = 0, value = 0;
  while (at < mask.length) {
    let end = mask.indexOf(1 - value, at);
    if (end < 0) end = mask.length;
    found.push(end - at);
    [at, value] = [end, 1 - value];
  }
  return found;
};

const fromRuns = (runs) => {
  mask.fill(0);
  let at = 0;
  runs.forEach((run, k) => { if (k % 2) mask.fill(1, at, at + run); at += run; });
  hatch(0, 0, columns, rows);
  count(runs);
  draw();
};

const count = (runs) => {
  const missing = runs.reduce((sum, run, k) => (k % 2 ? sum + run : sum), 0);
  say(`${missing} of ${mask.length} pixels are missing`);
  part("undo").disabled = !past.length;
  part("redo").disabled = !future.length;
};

const hatch = (x0, y0, x1, y1) => { // hatched, so that it is seen on any color
  [x0, y0] = [Math.max(0, Math.floor(x0)), Math.max(0, Math.floor(y0))];
  [x1, y1] = [Math.min(columns, Math.ceil(x1)), Math.min(rows, Math.ceil(y1))];
  if (x1 <= x0 || y1 <= y0) return;
  const pixels = new ImageData(x1 - x0, y1 - y0), codes = new Uint32Array(pixels.data.buffer);
  for (let y = y0, k = 0; y < y1; y += 1) {
    for (let x = x0; x < x1; x += 1, k += 1) {
      if (mask[y * columns + x]) codes[k] = (x + y) % 6 < 2 ? 0xff280078 : 0xc03232ff; // A B G R
    }
  }
  overlay.getContext("2d")?.putImageData(pixels, x0, y0);
};

let sending = Promise.resolve(); // one after the other, in the order in which they were painted
const send = (content) => {
  sending = sending.then(async () => {
    try {
      const answer = await fetch(place("mask"), { method: "POST", body: JSON.stringify(content) });
      const found = await answer.json();
      if (found.error) say(found.error);
      else if (content.runs === undefined) fromRuns(found.runs);
    } catch (error) { say(`mask: ${problem(error)}`); }
  });
};

const remember = (runs) => {
  past.push(runs);
  future = [];
  let kept = past.reduce((sum, each) => sum + each.length, 0);
  while (past.length > STEPS || (kept > MOST_KEPT && past.length > 1)) kept -= past.shift()?.length ?? 0;
};

const painted = (then) => { // then: runs of the mask before
  const runs = runsOf();
  remember(then);
  count(runs);
  draw();
  send({ columns, rows, runs });
};

const back = (from, to) => {
  if (!from.length) return;
  const runs = from.pop();
  to.push(runsOf());
  fromRuns(runs);
  send({ columns, rows, runs });
};

// ---- shapes -----------------------------------------------------------------------------------------------------
const value = () => (part("erase").checked ? 0 : 1);

const stroke = (a, b) => { // a line as wide as the brush
  const radius = Number(part("size").value) / 2, to = value();
  const [dx, dy] = [b[0] - a[0], b[1] - a[1]], long = dx * dx + dy * dy;
  const [x0, x1] = [Math.min(a[0], b[0]) - radius, Math.max(a[0], b[0]) + radius];
  const [y0, y1] = [Math.min(a[1], b[1]) - radius, Math.max(a[1], b[1]) + radius];
  for (let y = Math.max(0, Math.floor(y0)); y <= Math.min(rows - 1, y1); y += 1) {
    for (let x = Math.max(0, Math.floor(x0)); x <= Math.min(columns - 1, x1); x += 1) {
      const [px, py] = [x + 0.5 - a[0], y + 0.5 - a[1]];
      const along = long ? Math.min(1, Math.max(0, (px * dx + py * dy) / long)) : 0;
      if ((px - along * dx) ** 2 + (py - along * dy) ** 2 <= radius * radius) mask[y * columns + x] = to;
    }
  }
  hatch(x0 - 1, y0 - 1, x1 + 2, y1 + 2);
};

const polygon = (corners) => { // pixels whose centers are inside, where the outline crosses itself as often as not
  const to = value(), ys = corners.map(([, y]) => y);
  const first = Math.max(0, Math.floor(Math.min(...ys))), last = Math.min(rows - 1, Math.ceil(Math.max(...ys)));
  for (let y = first; y <= last; y += 1) {
    const crossings = [];
    corners.forEach(([x0, y0], k) => {
      const [x1, y1] = corners[(k + 1) % corners.length];
      if ((y0 <= y + 0.5) !== (y1 <= y + 0.5)) crossings.push(x0 + ((y + 0.5 - y0) / (y1 - y0)) * (x1 - x0));
    });
    crossings.sort((p, q) => p - q);
    const pixel = (x) => Math.min(columns, Math.max(0, Math.ceil(x - 0.5)));
    for (let k = 0; k + 1 < crossings.length; k += 2) {
      mask.fill(to, y * columns + pixel(crossings[k]), y * columns + pixel(crossings[k + 1]));
    }
  }
  hatch(0, first, columns, last + 1);
};

const rectangle = (a, b) => polygon([a, [b[0], a[1]], b, [a[0], b[1]]].map(([x, y]) => [Math.floor(x), Math.floor(y)]));

// ---- what is seen -----------------------------------------------------------------------------------------------
let frame = 0;
const drawn = () => {
  frame = 0;
  const canvas = part("canvas"), context = canvas.getContext("2d"), ratio = devicePixelRatio;
  const { scale, left, top } = viewport;
  canvas.width = Math.round(canvas.clientWidth * ratio);
  canvas.height = Math.round(canvas.clientHeight * ratio);
  if (image === null) return;
  context.setTransform(ratio * scale, 0, 0, ratio * scale, ratio * left, ratio * top);
  context.imageSmoothingEnabled = scale < 1.5;
  context.drawImage(image, 0, 0);
  context.drawImage(overlay, 0, 0);
  part("zoom").textContent = `${Math.round(scale * ratio * 100)} %`;
  if (path !== null && (tool === "lasso" || tool === "rectangle")) {
    const [a, b] = [path[0], path[path.length - 1]];
    outline(context, tool === "lasso" ? path : [a, [b[0], a[1]], b, [a[0], b[1]]]);
  } else if (pointer !== null && tool === "brush") {
    const radius = Number(part("size").value) / 2, [x, y] = pointer, turns = Array.from({ length: 48 }, (_, k) => (k * Math.PI) / 24);
    outline(context, turns.map((turn) => [x + radius * Math.cos(turn), y + radius * Math.sin(turn)]));
  }
};

const outline = (context, corners) => { // white on black, which is seen on any color
  for (const [color, width] of /** @type {[string, number][]} */ ([["#000", 3], ["#fff", 1.2]])) {
    context.strokeStyle = color;
    context.lineWidth = width / viewport.scale;
    context.beginPath();
    for (const corner of corners) context.lineTo(...corner);
    context.closePath();
    context.stroke();
  }
};

const draw = () => { frame ||= requestAnimationFrame(drawn); };
const viewport = new Viewport(() => part("canvas"), () => [columns, rows], draw);

// ---- image and mask of the server -------------------------------------------------------------------------------
const load = async () => {
  const picture = new Image();
  picture.src = place("picture", `&which=image&at=${Date.now()}`);
  await picture.decode();
  image = picture;
  [columns, rows] = [picture.naturalWidth, picture.naturalHeight];
  [overlay.width, overlay.height] = [columns, rows];
  mask = new Uint8Array(columns * rows);
  [past, future, path, pointer] = [[], [], null, null];
  await taken();
  viewport.fit();
};

const taken = async () => {
  const found = await (await fetch(place("mask"))).json();
  if (found.error) say(found.error);
  else fromRuns(found.runs);
};

const replaced = async () => { remember(runsOf()); await taken(); };

// The frame that is shown, as an image of the studio's folder; gives its name.
const shownFrame = async () => {
  const blob = await new Promise((done) => { one("#canvas").toBlob(done, "image/png"); });
  const address = `texture?tab=${encodeURIComponent(studio.tab)}&kind=png`;
  return (await (await fetch(address, { method: "POST", body: blob })).json()).name ?? "";
};

// ---- pointer ----------------------------------------------------------------------------------------------------
const isCanvas = (target) => image !== null && target === part("canvas");

const letGo = () => { // of a stroke that is not to be
  if (before !== null) fromRuns(before);
  [path, before] = [null, null];
  draw();
};

viewport.listen((event) => event.button !== 0 || tool === "move" || event.shiftKey, letGo);

on("pointerdown", (event, target) => {
  if (!isCanvas(target) || viewport.isPinched || event.button !== 0 || tool === "move" || event.shiftKey) return;
  pointer = viewport.at(event.clientX, event.clientY);
  if (tool === "color") {
    const [column, row] = pointer.map(Math.floor), tolerance = Number(part("tolerance").value) / 100;
    remember(runsOf());
    send({ column, row, tolerance, erase: part("erase").checked });
    return;
  }
  before = runsOf();
  path = [pointer];
  if (tool === "brush") stroke(pointer, pointer);
  draw();
});

on("pointermove", (event, target) => {
  if (!isCanvas(target)) return;
  pointer = viewport.at(event.clientX, event.clientY);
  draw();
  if (path === null) return;
  if (tool === "brush") stroke(path[path.length - 1], pointer);
  path.push(pointer);
});

const lifted = () => {
  if (path === null || before === null) return;
  const [way, runs] = [path, before];
  [path, before] = [null, null];
  if (tool === "rectangle") rectangle(way[0], way[way.length - 1]);
  if (tool === "lasso") polygon(way);
  painted(runs);
};
on("pointerup", lifted);
on("pointercancel", letGo);
on("pointerout", (_, target) => { if (isCanvas(target)) { pointer = null; draw(); } });

// ---- controls and keys ------------------------------------------------------------------------------------------
const ACTIONS = {
  clear: () => { const runs = runsOf(); mask.fill(0); hatch(0, 0, columns, rows); painted(runs); },
  undo: () => back(past, future), redo: () => back(future, past),
  fit: () => viewport.fit(), larger: () => viewport.zoom(1.5), smaller: () => viewport.zoom(1 / 1.5),
};

on("change", (_, target) => { if (target.dataset?.brush === "tool") tool = target.value; });
on("click", (_, target) => {
  const action = ACTIONS[target.dataset?.brush];
  if (action && image !== null) action();
});
on("click", (_, target) => { // flips between a result and the image before, or makes both large
  const { figure } = target.dataset ?? {};
  if (figure) target.setAttribute("aria-pressed", String(target.closest("figure").toggleAttribute(`data-${figure}`)));
});
window.addEventListener("resize", () => { if (image !== null && isOpen()) viewport.refit(); });

const resize = (key) => {
  const size = part("size"), was = Number(size.value), to = key === "[" ? Math.min(was - 1, was * 0.8) : Math.max(was + 1, was * 1.25);
  size.value = Math.round(to);
  draw();
};

const stepped = (event) => { // on the canvas arrows move the brush, and Enter paints
  const by = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
  if (by === undefined && event.key !== "Enter") return;
  event.preventDefault();
  pointer ??= [columns / 2, rows / 2];
  const far = (event.shiftKey ? 10 : 1) / Math.min(viewport.scale, 1);
  const from = pointer;
  if (by !== undefined) pointer = [pointer[0] + far * by[0], pointer[1] + far * by[1]];
  if (event.key === "Enter" || event.altKey) {
    const runs = runsOf();
    stroke(from, pointer);
    painted(runs);
  }
  draw();
};

const KEYS = {
  "[": () => resize("["), "]": () => resize("]"), 0: ACTIONS.fit,
  e: () => { part("erase").checked = !part("erase").checked; },
};

const pressed = (event, target) => { // in the dialog
  if (event.key === "Escape" && path !== null) event.preventDefault(); // the stroke goes, the dialog stays
  if (event.key === "Escape") { letGo(); return; }
  event.stopPropagation(); // keys of the picture behind the dialog, undo of the scene among them
  if (image === null || target.closest?.(TYPING)) return;
  if (event.ctrlKey || event.metaKey) {
    if (event.key.toLowerCase() !== "z") return;
    event.preventDefault();
    ACTIONS[event.shiftKey ? "redo" : "undo"]();
  } else if (event.key in KEYS) KEYS[event.key]();
  else if (target === part("canvas")) stepped(event);
};

on("keydown", (event, target) => {
  if (isOpen()) { pressed(event, target); return; }
  const isFree = !event.ctrlKey && !event.metaKey && !event.altKey && !target.closest?.(TYPING) && !one("dialog[open]");
  wantsFrame = event.key === "b" && isFree;
  if (wantsFrame) one("#inpaint").click();
}, { capture: true });

studio.brush = {
  load, replaced, shownFrame, sent: () => sending,
  opened: (hasImage) => {
    if (image !== null) draw();
    else if (hasImage) load();
    else if (wantsFrame) part("frame").click();
    wantsFrame = false;
  },
};

// The brush of inpainting: a mask is painted over an image, and goes to the server as runs.

import { studio } from "./shared.js";

const STEPS = 50; // of undo
const MOST_KEPT = 2 ** 22; // runs of all masks that undo may come back to
const LEAST_SCALE = 0.02, MOST_SCALE = 64; // CSS px per pixel of the image
const tab = () => document.querySelector("#studio").dataset.tab;
const one = (name) => document.querySelector(`[data-brush="${name}"]`);
const place = (what, rest = "") => `inpainting/${what}?tab=${encodeURIComponent(tab())}${rest}`;
const isOpen = () => Boolean(one("canvas")?.closest("dialog").open);

let image = null, tool = "brush";
let mask = new Uint8Array(0), columns = 0, rows = 0;
const overlay = document.createElement("canvas"); // the mask as it is seen, over the image
let scale = 1, left = 0, top = 0, fitted = true;
let past = [], future = []; // masks as runs
let pointer = null; // pixel of the image under the pointer
let path = null, before = null; // pixels that a stroke went through; runs of the mask when it began
let wantsFrame = false; // B takes the frame that is shown, where no image is open
const fingers = new Map();
let pinch = null;

const say = (text) => { one("told").textContent = text; };

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
  one("undo").disabled = !past.length;
  one("redo").disabled = !future.length;
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
  overlay.getContext("2d").putImageData(pixels, x0, y0);
};

let sending = Promise.resolve(); // one after the other, in the order in which they were painted
const send = (content) => {
  sending = sending.then(async () => {
    try {
      const answer = await fetch(place("mask"), { method: "POST", body: JSON.stringify(content) });
      const found = await answer.json();
      if (found.error) say(found.error);
      else if (content.runs === undefined) fromRuns(found.runs);
    } catch (error) { say(`mask: ${error.message}`); }
  });
};

const remember = (runs) => {
  past.push(runs);
  future = [];
  let kept = past.reduce((sum, each) => sum + each.length, 0);
  while (past.length > STEPS || (kept > MOST_KEPT && past.length > 1)) kept -= past.shift().length;
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
const value = () => (one("erase").checked ? 0 : 1);

const stroke = (a, b) => { // a line as wide as the brush
  const radius = Number(one("size").value) / 2, to = value();
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
const draw = () => { frame ||= requestAnimationFrame(drawn); };

const drawn = () => {
  frame = 0;
  const canvas = one("canvas"), context = canvas.getContext("2d"), ratio = devicePixelRatio;
  canvas.width = Math.round(canvas.clientWidth * ratio);
  canvas.height = Math.round(canvas.clientHeight * ratio);
  if (image === null) return;
  context.setTransform(ratio * scale, 0, 0, ratio * scale, ratio * left, ratio * top);
  context.imageSmoothingEnabled = scale < 1.5;
  context.drawImage(image, 0, 0);
  context.drawImage(overlay, 0, 0);
  one("zoom").textContent = `${Math.round(scale * ratio * 100)} %`;
  if (path !== null && (tool === "lasso" || tool === "rectangle")) {
    const [a, b] = [path[0], path.at(-1)];
    outline(context, tool === "lasso" ? path : [a, [b[0], a[1]], b, [a[0], b[1]]]);
  } else if (pointer !== null && tool === "brush") {
    const radius = Number(one("size").value) / 2, corners = [];
    for (let k = 0; k < 48; k += 1) {
      corners.push([pointer[0] + radius * Math.cos((k * Math.PI) / 24), pointer[1] + radius * Math.sin((k * Math.PI) / 24)]);
    }
    outline(context, corners);
  }
};

const outline = (context, corners) => { // white on black, which is seen on any color
  for (const [color, width] of [["#000", 3], ["#fff", 1.2]]) {
    context.strokeStyle = color;
    context.lineWidth = width / scale;
    context.beginPath();
    for (const corner of corners) context.lineTo(...corner);
    context.closePath();
    context.stroke();
  }
};

const fit = () => {
  const canvas = one("canvas");
  scale = Math.min(canvas.clientWidth / columns, canvas.clientHeight / rows, 8);
  left = (canvas.clientWidth - scale * columns) / 2;
  top = (canvas.clientHeight - scale * rows) / 2;
  fitted = true;
  draw();
};

const zoom = (factor, x, y) => { // about a point of the canvas
  const to = Math.min(Math.max(scale * factor, LEAST_SCALE), MOST_SCALE);
  left = x - ((x - left) * to) / scale;
  top = y - ((y - top) * to) / scale;
  [scale, fitted] = [to, false];
  draw();
};

const zoomMiddle = (factor) => zoom(factor, one("canvas").clientWidth / 2, one("canvas").clientHeight / 2);
const pan = (x, y) => { left += x; top += y; fitted = false; draw(); };

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
  fit();
};

const taken = async () => {
  const found = await (await fetch(place("mask"))).json();
  if (found.error) say(found.error);
  else fromRuns(found.runs);
};

const replaced = async () => { remember(runsOf()); await taken(); };

// The frame that is shown, as an image of the studio's folder; gives its name.
const shownFrame = async () => {
  const blob = await new Promise((done) => { document.querySelector("#canvas").toBlob(done, "image/png"); });
  const address = `texture?tab=${encodeURIComponent(tab())}&kind=png`;
  return (await (await fetch(address, { method: "POST", body: blob })).json()).name ?? "";
};

// ---- pointer ----------------------------------------------------------------------------------------------------
const position = (event) => {
  const box = one("canvas").getBoundingClientRect();
  return [(event.clientX - box.left - left) / scale, (event.clientY - box.top - top) / scale];
};

const isCanvas = (event) => image !== null && event.target === one("canvas");

const letGo = () => { // of a stroke that is not to be
  if (before !== null) fromRuns(before);
  [path, before] = [null, null];
  draw();
};

const spread = () => {
  const [a, b] = [...fingers.values()];
  return { x: (a[0] + b[0]) / 2, y: (a[1] + b[1]) / 2, apart: Math.hypot(a[0] - b[0], a[1] - b[1]) };
};

document.addEventListener("pointerdown", (event) => {
  if (!isCanvas(event)) return;
  event.target.setPointerCapture(event.pointerId);
  fingers.set(event.pointerId, [event.clientX, event.clientY]);
  if (fingers.size === 2) { letGo(); pinch = spread(); }
  if (fingers.size > 1 || event.button !== 0 || tool === "move" || event.shiftKey) return;
  pointer = position(event);
  if (tool === "color") {
    const [column, row] = pointer.map(Math.floor), tolerance = Number(one("tolerance").value) / 100;
    remember(runsOf());
    send({ column, row, tolerance, erase: one("erase").checked });
    return;
  }
  before = runsOf();
  path = [pointer];
  if (tool === "brush") stroke(pointer, pointer);
  draw();
});

document.addEventListener("pointermove", (event) => {
  if (!isCanvas(event)) return;
  const last = fingers.get(event.pointerId);
  pointer = position(event);
  draw();
  if (last === undefined) return;
  fingers.set(event.pointerId, [event.clientX, event.clientY]);
  if (pinch !== null) {
    if (fingers.size < 2) return;
    const now = spread(), box = event.target.getBoundingClientRect();
    pan(now.x - pinch.x, now.y - pinch.y);
    zoom(now.apart / Math.max(pinch.apart, 1), now.x - box.left, now.y - box.top);
    pinch = now;
  } else if (path === null) {
    if (tool !== "color") pan(event.clientX - last[0], event.clientY - last[1]);
  } else {
    if (tool === "brush") stroke(path.at(-1), pointer);
    path.push(pointer);
  }
});

const lifted = (event) => {
  if (!fingers.delete(event.pointerId)) return;
  if (!fingers.size) pinch = null;
  if (path === null) return;
  const [way, runs] = [path, before];
  [path, before] = [null, null];
  if (tool === "rectangle") rectangle(way[0], way.at(-1));
  if (tool === "lasso") polygon(way);
  painted(runs);
};
document.addEventListener("pointerup", lifted);
document.addEventListener("pointercancel", (event) => { if (fingers.has(event.pointerId)) letGo(); lifted(event); });
document.addEventListener("pointerout", (event) => { if (isCanvas(event)) { pointer = null; draw(); } });

document.addEventListener("wheel", (event) => {
  if (!isCanvas(event)) return;
  event.preventDefault();
  const box = event.target.getBoundingClientRect();
  zoom(1.0015 ** -event.deltaY, event.clientX - box.left, event.clientY - box.top);
}, { passive: false });

// ---- controls and keys ------------------------------------------------------------------------------------------
const ACTIONS = {
  clear: () => { const runs = runsOf(); mask.fill(0); hatch(0, 0, columns, rows); painted(runs); },
  undo: () => back(past, future), redo: () => back(future, past),
  fit, larger: () => zoomMiddle(1.5), smaller: () => zoomMiddle(1 / 1.5),
};

document.addEventListener("change", (event) => { if (event.target.dataset?.brush === "tool") tool = event.target.value; });
document.addEventListener("click", (event) => {
  const action = ACTIONS[event.target.dataset?.brush];
  if (action && image !== null) action();
});
window.addEventListener("resize", () => { if (image !== null && isOpen()) (fitted ? fit : draw)(); });

const resize = (key) => {
  const size = one("size"), was = Number(size.value), to = key === "[" ? Math.min(was - 1, was * 0.8) : Math.max(was + 1, was * 1.25);
  size.value = Math.round(to);
  draw();
};

const stepped = (event) => { // on the canvas arrows move the brush, and Enter paints
  const by = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
  if (by === undefined && event.key !== "Enter") return;
  event.preventDefault();
  pointer ??= [columns / 2, rows / 2];
  const far = (event.shiftKey ? 10 : 1) / Math.min(scale, 1);
  const from = pointer;
  if (by !== undefined) pointer = [pointer[0] + far * by[0], pointer[1] + far * by[1]];
  if (event.key === "Enter" || event.altKey) {
    const runs = runsOf();
    stroke(from, pointer);
    painted(runs);
  }
  draw();
};

document.addEventListener("keydown", (event) => {
  const typing = event.target.closest?.("input[type=text], input[type=number], select, textarea");
  const command = event.ctrlKey || event.metaKey;
  if (!isOpen()) {
    const isFree = !command && !event.altKey && !typing && !document.querySelector("dialog[open]");
    wantsFrame = event.key === "b" && isFree;
    if (wantsFrame) document.querySelector("#inpaint").click();
    return undefined;
  }
  if (event.key === "Escape" && path !== null) event.preventDefault(); // the stroke goes, the dialog stays
  if (event.key === "Escape") return letGo();
  event.stopPropagation(); // keys of the picture behind the dialog, undo of the scene among them
  if (image === null || typing) return undefined;
  if (command && event.key.toLowerCase() === "z") {
    event.preventDefault();
    return ACTIONS[event.shiftKey ? "redo" : "undo"]();
  }
  if (command) return undefined;
  if (event.key === "[" || event.key === "]") return resize(event.key);
  if (event.key === "e") { one("erase").checked = !one("erase").checked; return undefined; }
  if (event.key === "0") return fit();
  if (event.target === one("canvas")) return stepped(event);
  return undefined;
}, true);

studio.brush = {
  load, replaced, shownFrame, sent: () => sending,
  opened: (hasImage) => {
    if (image !== null) draw();
    else if (hasImage) load();
    else if (wantsFrame) one("frame").click();
    wantsFrame = false;
  },
};

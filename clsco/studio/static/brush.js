// The mode of inpainting: a mask is painted over an image, and goes to the server as runs; fillings are beside it, by a wipe.

import { all, on, one, problem, reword, stroked, studio } from "./shared.js";
import { Viewport } from "./viewport.js";

const TYPING = "input[type=text], input[type=number], select, textarea";
const STEPS = 50; // of undo
const MOST_KEPT = 2 ** 22; // runs of all masks that undo may come back to
const part = (name) => one(`[data-brush="${name}"]`);
const address = (what, rest = "") => `inpainting/${what}?tab=${encodeURIComponent(studio.tab)}${rest}`;
const isOpen = () => one("#studio").dataset.mode === "inpaint";

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
let start = null; // runs of the mask when it began
/** @type {Map<string, HTMLImageElement>} */
const fillings = new Map(); // by method
let chosen = "", isBefore = false; // the method that is seen beyond the wipe; the image alone is seen

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
  say(`${missing} of ${mask.length} px are painted over`);
  part("count").textContent = `${missing} px, ${Number((100 * missing / mask.length).toPrecision(2))} % are painted over`;
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
      const answer = await fetch(address("mask"), { method: "POST", body: JSON.stringify(content) });
      const found = await answer.json();
      if (found.error) say(found.error);
      else if (content.runs === undefined) { fromRuns(found.runs); clear(); }
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
  clear();
  remember(then);
  count(runs);
  draw();
  send({ columns, rows, runs });
};

const back = (from, to) => {
  if (!from.length) return;
  const runs = from.pop();
  to.push(runsOf());
  clear();
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
  if (!isBefore) context.drawImage(overlay, 0, 0);
  split(context);
  reword(one("#zoom"), `${Math.round(scale * ratio * 100)} %`);
  if (path !== null && (tool === "lasso" || tool === "rectangle")) {
    const [a, b] = [path[0], path[path.length - 1]], corners = tool === "lasso" ? path : [a, [b[0], a[1]], b, [a[0], b[1]]];
    outline(context, () => { for (const [x, y] of corners) context.lineTo(x, y); });
  } else if (pointer !== null && tool === "brush") {
    const [x, y] = pointer;
    outline(context, () => context.arc(x, y, Number(part("size").value) / 2, 0, 2 * Math.PI));
  }
};

const split = (context) => { // what fills the mask, beyond the wipe
  const filled = isBefore || path !== null ? undefined : fillings.get(chosen), wipe = part("wipe");
  viewport.lay(wipe);
  for (const each of [wipe, part("left"), part("right")]) each.hidden = filled === undefined;
  if (filled === undefined) return;
  reword(part("right"), `filled: ${one(`[data-card="${chosen}"] b`).textContent.toLowerCase()}`);
  const from = (columns * wipe.value) / 100;
  context.save();
  context.beginPath();
  context.rect(from, 0, columns - from, rows);
  context.clip();
  context.drawImage(filled, 0, 0);
  context.restore();
};

const outline = (context, trace) => stroked(context, "#fff", [3 / viewport.scale, 1.2 / viewport.scale], () => { trace(); context.closePath(); });

const draw = () => { frame ||= requestAnimationFrame(drawn); };
const viewport = new Viewport(() => part("canvas"), () => [columns, rows], draw);

// ---- fillings: each has a card with the same part of the picture ------------------------------------------------
const clear = (isStale = true) => { // they are of another mask; isStale: the cards show them still
  fillings.clear();
  for (const card of all("[data-card]")) card.toggleAttribute("data-stale", isStale);
  deal();
  draw();
};

const place = () => { // of the cards' part of the image: about a pixel in the middle of those that are painted over
  const { width, height } = one("[data-card] canvas"), wide = Math.min(Math.max(columns / 5, 24), columns), high = wide * height / width;
  const marked = [];
  for (let at = mask.indexOf(1); at >= 0; at = mask.indexOf(1, at + 1)) marked.push(at);
  const middle = marked[marked.length >> 1] ?? 0, fit = (at, size, most) => Math.max(0, Math.min(at - size / 2, most - size));
  return [fit(middle % columns, wide, columns), fit(Math.floor(middle / columns), high, rows), wide, high];
};

const deal = () => { // pictures onto the cards
  const part = place();
  for (const card of all("[data-card]")) {
    const canvas = card.querySelector("canvas"), context = canvas.getContext("2d"), source = fillings.get(card.dataset.card);
    context.imageSmoothingEnabled = false;
    for (const layer of source ? [source] : [image, overlay]) context.drawImage(layer, ...part, 0, 0, canvas.width, canvas.height);
    card.setAttribute("aria-pressed", String(source !== undefined && card.dataset.card === chosen));
  }
};

const filled = async (method, methods = [...fillings.keys(), method]) => {
  for (const each of fillings.keys()) if (!methods.includes(each)) fillings.delete(each);
  const picture = new Image();
  picture.src = address("picture", `&which=${method}&at=${Date.now()}`);
  try {
    await picture.decode();
    fillings.set(method, picture);
    chosen = method;
  } catch { // the mask has changed since
    fillings.delete(method);
  }
  deal();
  draw();
};

// ---- image and mask of the server -------------------------------------------------------------------------------
const soon = () => new Promise((done) => { setTimeout(done, 100); });
const load = async () => {
  while (!studio.isOpen()) await soon(); // the server knows what this tab had
  const { name } = await (await fetch(address("mask"))).json(), picture = new Image();
  if (!name) { part("frame").click(); return; } // of this tab
  picture.src = address("picture", `&which=image&at=${Date.now()}`);
  await picture.decode();
  image = picture;
  [columns, rows] = [picture.naturalWidth, picture.naturalHeight];
  [overlay.width, overlay.height] = [columns, rows];
  mask = new Uint8Array(columns * rows);
  [past, future, path, pointer] = [[], [], null, null];
  await masked();
  part("name").textContent = name;
  part("pixels").textContent = `${columns} × ${rows} px`;
  const small = part("thumbnail"), scale = Math.max(small.width / columns, small.height / rows);
  small.getContext("2d").drawImage(picture, (small.width - scale * columns) / 2, (small.height - scale * rows) / 2, scale * columns, scale * rows);
  viewport.fit();
  isFresh = true;
  await refill();
};

let isFresh = false; // its cards, which may come later, may be filled already, if the page was loaded again
const refill = async () => {
  const cards = all("[data-filled]");
  if (!isFresh || !cards.length) return;
  isFresh = false;
  for (const card of cards) await filled(card.dataset.card);
};
studio.hearing.push((said) => { if ("part" in said) setTimeout(refill); });

const masked = async () => {
  const { error, runs } = await (await fetch(address("mask"))).json();
  if (error) say(error);
  else { fromRuns(runs); clear(false); }
};

// The frame that is shown, as an image of the studio's folder; gives its name.
const shownFrame = async () => {
  while (one("#canvas").width === 1) await soon(); // no picture yet
  const blob = await new Promise((done) => { one("#canvas").toBlob(done, "image/png"); });
  return studio.uploaded(Object.assign(blob, { name: "frame.png" }));
};

// ---- pointer ----------------------------------------------------------------------------------------------------
const isCanvas = (target) => image !== null && target === part("canvas");

const letGo = () => { // of a stroke that is not to be
  if (start !== null) fromRuns(start);
  [path, start] = [null, null];
  draw();
};

viewport.listen((event) => event.button !== 0 || event.shiftKey, letGo);

on("pointerdown", (event, target) => {
  if (!isCanvas(target) || viewport.isPinched || event.button !== 0 || event.shiftKey) return;
  pointer = viewport.at(event.clientX, event.clientY);
  if (tool === "color") {
    const [column, row] = pointer.map(Math.floor), tolerance = Number(part("tolerance").value) / 100;
    if (Math.min(column, row) < 0 || column >= columns || row >= rows) return;
    remember(runsOf());
    send({ column, row, tolerance, erase: part("erase").checked });
    return;
  }
  start = runsOf();
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
  if (path === null || start === null) return;
  const [way, runs] = [path, start];
  [path, start] = [null, null];
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
  undo: () => back(past, future), redo: () => back(future, past), before: () => before(!isBefore),
};

on("change", (_, target) => {
  if (target.dataset?.brush !== "tool") return;
  tool = target.value;
  part("tolerance").parentElement.hidden = tool !== "color";
  part("size").parentElement.hidden = tool !== "brush";
});
on("input", (_, target) => {
  if (target.dataset?.brush === "wipe") draw();
  else if (target.closest?.("#brush")) label();
});
const label = () => { // of the boxes of the brush
  for (const [name, unit] of [["size", "px"], ["tolerance", "%"]]) {
    const slider = part(name);
    slider.style.setProperty("--at", `${(100 * (slider.value - slider.min)) / (slider.max - slider.min)}%`);
    part(`${name}-about`).textContent = `${slider.value} ${unit}`;
  }
};
on("click", (_, target) => {
  if (target.dataset?.mode) studio.mode(target.dataset.mode);
  if (image !== null) ACTIONS[target.closest("[data-brush]")?.dataset.brush]?.();
  const { card, filled: isFilled, stale } = target.closest("[data-card]")?.dataset ?? {};
  if (isFilled === undefined || stale !== undefined) return;
  chosen = card;
  deal();
  draw();
});
const before = (is) => {
  isBefore = is;
  part("before").setAttribute("aria-pressed", String(is));
  draw();
};

const resize = (key) => {
  const size = part("size"), was = Number(size.value), to = key === "[" ? Math.min(was - 1, was * 0.8) : Math.max(was + 1, was * 1.25);
  size.value = Math.round(to);
  label();
  draw();
};

const stepped = (event) => { // on the canvas arrows move the brush, and Enter paints
  const by = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
  if (by === undefined && event.key !== "Enter") return;
  event.preventDefault();
  pointer ??= [columns / 2, rows / 2];
  const far = (event.shiftKey ? 10 : 1) / Math.min(viewport.scale, 1), from = pointer;
  if (by !== undefined) pointer = [pointer[0] + far * by[0], pointer[1] + far * by[1]];
  if (event.key === "Enter" || event.altKey) {
    const runs = runsOf();
    stroke(from, pointer);
    painted(runs);
  }
  draw();
};

const KEYS = {
  "[": () => resize("["), "]": () => resize("]"), 0: () => viewport.fit(), b: () => studio.mode("lens"),
  e: () => { part("erase").checked = !part("erase").checked; },
};
const OF_THE_PAGE = ["i", "?", "Tab"]; // keys

const pressed = (event, target) => { // in the mode
  if (event.key === "Escape" && path !== null) { event.stopPropagation(); letGo(); return; }
  if (target.closest?.(TYPING) || event.key === "Escape") return;
  if (event.ctrlKey || event.metaKey) {
    if (event.key.toLowerCase() !== "z") return;
    event.preventDefault();
    event.stopPropagation(); // of undo of the scene
    if (image !== null) ACTIONS[event.shiftKey ? "redo" : "undo"]();
    return;
  }
  if (!OF_THE_PAGE.includes(event.key)) event.stopPropagation(); // keys of the picture
  if (image === null) return;
  if (event.key === " " && target === document.body) { event.preventDefault(); before(true); }
  else if (event.key in KEYS && !event.altKey) KEYS[event.key]();
  else if (target === part("canvas")) stepped(event);
};

on("keydown", (event, target) => {
  if (one("dialog:modal")) return;
  if (isOpen()) { pressed(event, target); return; }
  if (event.key === "b" && !event.ctrlKey && !event.metaKey && !event.altKey && !target.closest?.(TYPING)) studio.mode("inpaint");
}, { capture: true });
on("keyup", (event) => { if (event.key === " " && isBefore && event.target === document.body) before(false); });
/** Shows the scene ("lens") or the image that is painted over ("inpaint"), which is at first the frame that is shown. */
studio.mode = (name) => {
  one("#studio").dataset.mode = name;
  for (const button of all("#mode button")) button.setAttribute("aria-checked", String(button.dataset.mode === name));
  studio.moded();
  studio.viewport = isOpen() ? viewport : studio.stageView;
  if (!isOpen() || image !== null) studio.viewport.refit();
  else load();
};

studio.parts.push(() => {
  label();
  new ResizeObserver(() => { if (image !== null && isOpen()) viewport.refit(); }).observe(part("canvas"));
});
studio.brush = { load, replaced: () => { remember(runsOf()); masked(); }, shownFrame, filled, sent: () => sending };

// The part of the studio that must be quick: pictures onto a canvas, and sliders' values to the server, over one socket.
// What changes which elements there are is in parts.js. Whatever has an attribute data-path is the control of that key of the scene.

import { ENCODING, RUNG, VIEWS, opened } from "./protocol.js";
import { brief, full, placeOf, valueAt } from "./scales.js";
import { all, on, one, problem, reword, sameKey, studio } from "./shared.js";
import { Viewport } from "./viewport.js";
import { decoded, plane, summed } from "./views.js";

import "./badge.js";
import "./lens.js";
import "./shell.js";
import "./instruments.js";
import "./parts.js";
import "./persistence.js";
import "./tools.js";
import "./timeline.js";
import "./keyframes.js";
import "./compare.js";
import "./progress.js";
import "./inspect.js";
import "./files.js";
import "./forms.js";
import "./brush.js";

const FRAME = 12; // ms between changes that are sent at once
const ECHO = 300; // ms in which the server answers a change
const NUMBERS_FROM = 24; // CSS px per pixel of the image

// ---- the socket -------------------------------------------------------------------------------------------------
/** @type {WebSocket | null} */
let socket = null;
const GONE = 4404; // the page is of a studio that ended, or was loaded again
let tries = 0, link = ""; // link: a scene in the address
studio.isOpen = () => socket?.readyState === WebSocket.OPEN;
const send = studio.send = (content) => { if (studio.isOpen()) socket?.send(JSON.stringify(content)); };

// Another server may listen at the address after the studio has ended: nothing else is sent there before it has proved
// that it knows the key of the page. Browsers offer the code only to secure pages: others are to be loaded anew by hand.
const isOurs = async () => {
  if (!window.isSecureContext) return false;
  const bytes = (text) => Uint8Array.from(text.match(/../g) ?? [], (pair) => parseInt(pair, 16));
  const number = [...crypto.getRandomValues(new Uint8Array(16))].map((byte) => byte.toString(16).padStart(2, "0")).join("");
  const kind = { name: "HMAC", hash: "SHA-256" };
  try {
    const key = await crypto.subtle.importKey("raw", bytes(one("#studio").dataset.proof), kind, false, ["verify"]);
    const answer = await fetch(`${location.origin}/prove?${number}`, { credentials: "omit", cache: "no-store", redirect: "error" });
    return await crypto.subtle.verify(kind, key, bytes(await answer.text()), new TextEncoder().encode(number));
  } catch { return false; }
};

const again = () => {
  studio.closed();
  tries += 1;
  setTimeout(async () => { if (await isOurs()) connect(); else again(); }, Math.min(250 * 2 ** tries, 8000));
};

const connect = () => {
  socket = new WebSocket(new URL(`frames?tab=${studio.tab}&page=${one("#studio").dataset.page}`, location.href.replace(/^http/, "ws")));
  socket.binaryType = "arraybuffer";
  socket.onopen = () => {
    tries = 0;
    studio.revision = -1;
    studio.revised(null);
    watched = "";
    watch();
    if (link) send({ link });
    link = "";
    send({ view: studio.view });
    send(studio.wanted());
    studio.opened();
  };
  socket.onmessage = (event) => received(event.data);
  socket.onclose = async ({ code }) => {
    if (code === GONE && await isOurs()) location.reload();
    else again();
  };
};

const received = (buffer) => {
  const { picture, payload } = opened(buffer);
  if (picture.rung < RUNG.PINNED) studio.revised(picture.revision);
  if (picture.encoding !== ENCODING.MESSAGE) { show(picture, payload); return; }
  const said = JSON.parse(new TextDecoder().decode(payload));
  if ("undo" in said) studio.boxed(picture.revision);
  told(said);
};

// ---- pictures ---------------------------------------------------------------------------------------------------
/** @type {Promise<void>} */
let queue = Promise.resolve(); // pictures are painted in the order in which they come
const show = (picture, payload) => {
  const isImage = picture.encoding === ENCODING.JPEG || picture.encoding === ENCODING.PNG;
  const drawable = isImage ? decoded(picture, payload) : plane(picture, payload);
  queue = queue.then(async () => {
    const image = await drawable;
    if (picture.rung === RUNG.OUTLINED) studio.outlined(picture);
    else if (picture.rung === RUNG.STACKED) studio.stacked(picture, image);
    else if (picture.rung >= RUNG.PINNED) studio.pinned(image, picture);
    else if (asked(picture) && picture.revision >= studio.revision) paint(picture, image);
    await new Promise(requestAnimationFrame);
    send({ ack: [picture.revision, picture.rung] });
    if (!asked(picture) || picture.rung >= RUNG.PINNED) return;
    if (picture.rung === RUNG.EXACT) studio.rested();
    studio.painted.push([picture.revision, picture.rung, performance.now()]);
    if (studio.painted.length > 500) studio.painted.shift();
  }).catch((error) => {
    send({ ack: [picture.revision, picture.rung] });
    told({ error: [`picture: ${problem(error)}`] });
  });
};

const asked = (picture) => picture.view === studio.view && picture.right === studio.right;

const paint = (picture, image) => {
  const canvas = one("#canvas"), context = canvas.getContext("2d", { willReadFrequently: false });
  const [columns, rows] = picture.full;
  if (canvas.width !== columns || canvas.height !== rows) {
    canvas.width = columns;
    canvas.height = rows;
    viewport.fit();
  }
  context.imageSmoothingEnabled = picture.view === "color" || picture.view === "sharp";
  if (image.width !== columns || image.height !== rows) context.imageSmoothingQuality = "high";
  context.drawImage(image, 0, 0, columns, rows);
  image.close();
  studio.revision = picture.revision;
  studio.rung = picture.rung;
  studio.badge(picture);
  reword(one("#size"), `${columns} × ${rows} px`);
  studio.done();
  studio.compare();
  legend(picture.legend);
  studio.measure();
  placed();
  studio.drawn(picture);
  studio.stale(true);
};

const legend = (about) => {
  one("#legend").hidden = about === undefined;
  if (about === undefined) return;
  for (const name of ["least", "most", "about"]) reword(one(`#legend-${name}`), about[name]);
  const bar = one("#legend-bar"), context = bar.getContext("2d");
  const pixels = context.createImageData(bar.width, 1);
  for (let x = 0; x < bar.width; x += 1) pixels.data.set([...about.color(x / (bar.width - 1)), 255], 4 * x);
  for (let y = 0; y < bar.height; y += 1) context.putImageData(pixels, 0, y);
};

// ---- zoom and pan: the canvas has the frame's pixels, and is scaled by its style --------------------------------
const placed = () => {
  const { scale, left, top } = viewport;
  for (const each of all("#canvas, #pinned, #stacked")) {
    each.style.transform = `translate(${left}px, ${top}px) scale(${scale})`;
    each.style.imageRendering = scale >= 1.5 ? "pixelated" : "auto";
  }
  viewport.lay(one("#wipe"));
  if (studio.viewport === viewport) reword(one("#zoom"), viewport.size()[0] > 1 ? `${Math.round(scale * devicePixelRatio * 100)} %` : "");
  awaitsOver ||= requestAnimationFrame(over);
};

const viewport = new Viewport(() => one("#stage"), () => [one("#canvas").width, one("#canvas").height], placed);
studio.viewport = studio.stageView = viewport; // that of the brush in its mode

let awaitsOver = 0, stage = { width: 0, height: 0 }; // its size, which is not asked for while much changes
const over = () => { // what is drawn over the picture, once before it is shown
  awaitsOver = 0;
  const canvas = one("#over"), { width, height } = stage, context = canvas.getContext("2d");
  if (canvas.width !== Math.floor(width) || canvas.height !== Math.floor(height)) [canvas.width, canvas.height] = [width, height];
  context.clearRect(0, 0, width, height);
  for (const draw of studio.overlays) draw(context, viewport.place);
  if (viewport.scale >= NUMBERS_FROM && one("#canvas").width > 1) numbers(context, width, height);
};

const numbers = (context, width, height) => { // the codes, written in the pixels
  const { scale, left, top } = viewport, canvas = one("#canvas");
  const [x0, y0] = [Math.max(0, Math.floor(-left / scale)), Math.max(0, Math.floor(-top / scale))];
  const columns = Math.min(canvas.width - x0, Math.ceil(width / scale) + 1);
  const rows = Math.min(canvas.height - y0, Math.ceil(height / scale) + 1);
  if (columns < 1 || rows < 1) return;
  const { data } = canvas.getContext("2d").getImageData(x0, y0, columns, rows);
  context.font = `${Math.min(scale / 3.4, 13)}px ui-monospace, monospace`;
  context.textAlign = "center";
  context.textBaseline = "middle";
  for (let y = 0; y < rows; y += 1) {
    for (let x = 0; x < columns; x += 1) {
      const [r, g, b] = data.subarray(4 * (y * columns + x)), [across, down] = viewport.place(x0 + x, y0 + y);
      context.fillStyle = 0.3 * r + 0.6 * g + 0.1 * b > 127 ? "#000" : "#fff";
      const lines = r === g && g === b ? [r] : scale >= 40 ? [r, g, b] : [g];
      lines.forEach((value, line) => context.fillText(value, across, down + (line - (lines.length - 1) / 2) * scale * 0.3));
    }
  }
};

const pointing = () => {
  viewport.listen((event) => event.button === 0 && !studio.tool && studio.handleAt(event.clientX, event.clientY) === null);
  one("#stage").addEventListener("dblclick", () => viewport.fit());
  one("#fit").addEventListener("click", () => studio.viewport.fit());
  one("#actual").addEventListener("click", () => studio.viewport.zoom(1 / devicePixelRatio / studio.viewport.scale));
  new ResizeObserver(([{ contentRect }]) => {
    stage = contentRect;
    viewport.refit();
  }).observe(one("#stage"));
};

// ---- controls ---------------------------------------------------------------------------------------------------
let drag = 0;
/** @type {{ path: string, before: any, at: number } | null} of the control, and its value before it */
let dragged = null;
const waiting = new Map(); // values not yet sent, by path: the latest wins
let watched = "", flushed = 0;

const flush = studio.flush = () => {
  flushed = performance.now();
  for (const [path, [value, number]] of waiting) {
    send({ path, value, drag: number, count: studio.changes(path) });
    studio.sent.set(path, value);
  }
  waiting.clear();
};

const put = studio.put = (path, value) => {
  if (!waiting.size) (performance.now() - flushed > FRAME ? queueMicrotask : requestAnimationFrame)(flush);
  waiting.set(path, [value, drag]);
};
studio.placeOf = placeOf;
studio.set = (path, value) => { drag += 1; put(path, value); }; // as a step of undo of its own

const fine = (control) => (control.dataset.scale ? valueAt(control) : Number(control.value));
const valueOf = (control, isFine) => {
  if (control.type === "checkbox") return control.checked;
  if (control.type === "range") return isFine || !control.dataset.step ? fine(control) : valueAt(control);
  if (control.type === "number" || control.dataset.kind === "number") {
    const text = control.value.trim();
    return text === "" ? null : Number.isFinite(Number(text)) ? Number(text) : text;
  }
  return control.value;
};

const changing = (control, isFine = false) => {
  const path = control.dataset.path, value = valueOf(control, isFine);
  control.removeAttribute("data-empty");
  if (control.dataset.full !== undefined) control.dataset.full = control.value;
  if (control.type === "range") fill(control);
  if (dragged === null || dragged.path !== path) {
    drag += 1;
    dragged = { path, before: studio.values[path], at: 0 };
  }
  dragged.at = performance.now();
  for (const other of sameKey(path)) if (other !== control) give(other, value);
  put(path, value);
};

const give = (control, value) => {
  if (control.type === "checkbox") control.checked = Boolean(value);
  else if (control.type === "radio") control.checked = control.value === value;
  else if (control.type === "range") slide(control, value);
  else if (control.dataset.kind === "number") write(control, value);
  else control.value = full(value);
};

const slide = (control, value) => { // a slider of an empty box has no place
  control.toggleAttribute("data-empty", typeof value !== "number");
  control.value = placeOf(control, value ?? control.dataset.default ?? valueAt(control, Number(control.min)));
  fill(control);
};

const fill = (control) => { // as far as its place in the range
  const share = (Number(control.value) - control.min) / (control.max - control.min);
  control.style.setProperty("--at", `${100 * share}%`);
};

const write = (control, value) => { // all digits where somebody types
  control.dataset.full = full(value);
  control.value = control === document.activeElement ? control.dataset.full : brief(value);
};

const opens = (_, control) => {
  if (control.dataset?.full !== undefined && control.value === brief(studio.values[control.dataset.path])) {
    control.value = control.dataset.full;
    control.select();
  }
};

const leaves = (_, control) => {
  const value = studio.values[control.dataset?.path];
  if (control.dataset?.full === undefined || typeof value !== "number" || Number(control.value) !== value) return;
  control.dataset.full = full(value);
  control.value = brief(value);
};

const stepped = (event, control) => { // arrows: with Shift ten times as far, with Alt a tenth
  const sign = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[event.key], isBox = control.dataset?.kind === "number";
  if (isBox && /Up|Down/.test(event.key)) control = control.parentElement.querySelector("input[type=range]") ?? control;
  if (sign === undefined || control.type !== "range" || !control.dataset.path) return;
  event.preventDefault();
  const step = Number(control.dataset.step || control.step) || 1;
  const size = step * (event.shiftKey ? 10 : event.altKey ? 0.1 : 1);
  const to = Number(control.value) + sign * size;
  control.value = Number(Math.min(Math.max(to, control.min), control.max).toPrecision(12));
  changing(control, true);
};

const filled = new WeakSet(); // controls; those that are drawn anew may have values that are older than what was told
const watch = () => { // tell the server which keys are on the page, so that it tells their values
  const fresh = all("[data-path]").filter((control) => !filled.has(control));
  for (const control of fresh) {
    filled.add(control);
    if (control.dataset.path in studio.values) give(control, studio.values[control.dataset.path]);
  }
  if (fresh.length) { studio.mark(); idle(); }
  const paths = [...new Set(all("[data-path], [data-thumbnail]").map(({ dataset }) => dataset.path ?? dataset.thumbnail))];
  summed();
  if (paths.join("\n") === watched) return;
  watched = paths.join("\n");
  send({ watch: paths });
};

// A control that does nothing is disabled and says why, but for one whose value is at fault.
const WITHOUT = { moves: "nothing moves", sensor: "the scene has no sensor: see its panel" };
const idle = () => {
  for (const control of all("[data-only]")) {
    const [path, values] = control.dataset.only.split("="), now = studio.values[path];
    const works = now === undefined || (values === undefined ? now : values.split("|").includes(now)) || control.dataset.path in studio.faults;
    control.disabled = !works;
    const reason = WITHOUT[path] ?? `only with ${path} = ${values?.replace("|", " or ")}`;
    const place = control.closest(".live, .field, .vector");
    if (place === null) control.title = works ? "" : reason;
    else if (works) place.removeAttribute("data-idle");
    else place.setAttribute("data-idle", reason);
  }
};

const told = (said) => {
  if (said.error) { fail(said.error); studio.notInspected(); }
  if (said.about) reword(one("#plan"), said.about.plan);
  if (said.given) studio.values.given = said.given;
  if (said.values) valued(said.values);
  for (const name of Object.keys(WITHOUT)) if (name in said) studio.values[name] = said[name];
  if (said.faults && JSON.stringify(said.faults) !== JSON.stringify(studio.faults)) { studio.faults = said.faults; studio.mark(); }
  if (said.values || said.given) { idle(); summed(); }
  if (one(`[data-view="${studio.view}"]`).disabled) look("color");
  if ("undo" in said) { one("#undo").disabled = !said.undo; one("#redo").disabled = !said.redo; }
  for (const hear of studio.hearing) hear(said);
};

const valued = (values) => {
  Object.assign(studio.values, values);
  for (const [path, value] of Object.entries(values)) {
    const isTyped = dragged?.path === path && performance.now() - dragged.at < ECHO;
    if (waiting.has(path) || studio.isEcho(path) || isTyped) continue; // older than what is in the box
    for (const control of sameKey(path)) give(control, value);
  }
};

let failing = 0;
const fail = (messages) => notify(messages.join(";\n"), false);
const notify = (text, isGood) => { // in the status, or above a dialog
  const place = one("#message");
  place.textContent = place.title = text;
  place.toggleAttribute("data-good", isGood);
  place.hidden = false;
  if (one("dialog:modal")) place.showPopover();
  clearTimeout(failing);
  failing = setTimeout(dismiss, isGood ? 3000 : 6000);
};
const dismiss = () => { // false where there is no message
  const place = one("#message"), isThere = !place.hidden;
  place.hidePopover();
  place.hidden = true;
  return isThere;
};
Object.assign(studio, { fail, notify });

const CLICKS = { // what a click on an element with such an attribute does
  do: (action) => send({ do: action }),
  show: (selector) => one(selector).showModal(),
  close: (selector) => one(selector).close(),
  toggle: (name) => studio.dock(name),
  view: (view) => look(view),
};

const controls = () => {
  on("input", (_, control) => { if (control.dataset?.path) changing(control); });
  for (const end of /** @type {const} */ (["change", "focusout"])) {
    on(end, (_, control) => { if (control.dataset?.path) dragged = null; });
  }
  on("keydown", stepped, { capture: true });
  on("close", () => one("#message").hidePopover(), { capture: true }); // it is seen in the status
  on("focusin", opens);
  on("focusout", leaves);
  on("click", (_, target) => {
    for (const [name, act] of Object.entries(CLICKS)) {
      const element = target.closest(`[data-${name}]`);
      if (element) act(element.dataset[name]);
    }
  });
  on("dblclick", (_, target) => { // on a label: to the default
    const path = target.closest("[data-clear]")?.dataset.clear;
    if (path) studio.set(path, null);
  });
  const isElement = (node) => node instanceof Element; // words come and go all the time
  new MutationObserver((changes) => {
    if (changes.some(({ addedNodes, removedNodes }) => [...addedNodes, ...removedNodes].some(isElement))) requestAnimationFrame(watch);
  }).observe(document.body, { childList: true, subtree: true });
};

// ---- views ------------------------------------------------------------------------------------------------------
const look = studio.look = (view) => {
  if (view !== studio.view) studio.rung = -1;
  studio.view = view;
  studio.badge();
  for (const button of all("[data-view]")) button.setAttribute("aria-selected", String(button.dataset.view === view));
  send({ view });
  studio.unstack();
  studio.expose();
};

// ---- keyboard ---------------------------------------------------------------------------------------------------
const taken = () => { // a drag of a control that is given up
  if (dragged === null) return false;
  const { path, before } = dragged;
  put(path, before ?? null);
  for (const other of sameKey(path)) give(other, before);
  dragged = null;
  return true;
};

const press = (event, selector) => { event.preventDefault(); one(selector)?.click(); };
const COMMANDS = { // with Ctrl
  z: (event) => { dragged = null; press(event, event.shiftKey ? "#redo" : "#undo"); },
  s: (event) => press(event, "#save"),
  enter: (event) => press(event, "#generate"),
  k: (event) => { event.preventDefault(); studio.find(); },
};
const KEYS = {
  ",": () => studio.seek(studio.index - 1),
  ".": () => studio.seek(studio.index + 1),
  e: (event) => { if (!one("#eye").hidden) press(event, "#eye"); },
  "?": () => one("#keys").showModal(),
  "[": () => studio.dock("open"),
  i: () => studio.dock("sided"),
  l: () => one("#ruler input").focus(),
  a: () => one("#opening input").focus(),
};
const TYPING = "input:not([type=range]):not([type=checkbox]):not([type=radio]), textarea, select";

const keys = (event, target) => {
  const key = event.key.toLowerCase();
  if (event.ctrlKey || event.metaKey) { COMMANDS[key]?.(event); return; }
  if (key === "escape" && !taken() && !dismiss()) studio.escape();
  if (key === "escape" && target.matches?.(TYPING)) target.blur(); // from here on letters are shortcuts
  if (event.altKey || target.closest?.(TYPING) || one("dialog:modal")) return;
  if (/^[1-9]$/.test(key)) one(`[data-view="${VIEWS[Number(key) - 1]}"]`).click();
  else if (key in KEYS) KEYS[key](event);
  else studio.extra(event);
};

const start = (name) => {
  studio.tab = name;
  link = location.hash.startsWith("#s=") ? location.hash : "";
  history.replaceState(null, "", `?s=${name}`);
  pointing();
  controls();
  studio.begin();
  on("keydown", keys);
  for (const part of studio.parts) part();
  window.addEventListener("beforeunload", () => { tries = 4; send({ leaving: true }); });
  connect();
};

start(one("#studio").dataset.tab);

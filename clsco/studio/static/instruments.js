// Instruments beside and over the picture: histogram with clipping, focus peaking, outline of an object, wipe.

import "./handles.js";
import { RUNG } from "./protocol.js";
import { brief } from "./scales.js";
import { on, one, problem, studio } from "./shared.js";

const PEAK = 40; // codes by which a pixel differs from the mean of those around it, where it is in focus

const isImage = () => studio.view === "color" || studio.view === "sharp";
const codes = () => { // of what is seen: the frame, the step of a stack in its place, or the pinned frame without a wipe
  const pinned = one("#wipe").hidden ? one("#pinned:not([hidden])") : null;
  const canvas = one("#stacked:not([hidden])") ?? pinned ?? one("#canvas");
  return canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
};

// ---- histogram --------------------------------------------------------------------------------------------------
const counted = ({ data }) => {
  const counts = [0, 1, 2].map(() => new Float64Array(256));
  let dark = 0, bright = 0;
  for (let at = 0; at < data.length; at += 4) {
    for (let channel = 0; channel < 3; channel += 1) counts[channel][data[at + channel]] += 1;
    dark += Number(Math.max(data[at], data[at + 1], data[at + 2]) === 0);
    bright += Number(Math.max(data[at], data[at + 1], data[at + 2]) === 255);
  }
  return { counts, dark: (400 * dark) / data.length, bright: (400 * bright) / data.length };
};

const plot = (counts) => { // square roots, so that few are seen beside many; the ends, which may have most, do not scale it
  const canvas = one("#histogram"), context = canvas.getContext("2d"), { width, height } = canvas;
  const most = Math.max(1, ...counts.flatMap((each) => [...each.subarray(1, 255)]));
  context.clearRect(0, 0, width, height);
  context.globalCompositeOperation = "lighter";
  counts.forEach((each, channel) => {
    context.fillStyle = ["#a33", "#3a3", "#33a"][channel];
    each.forEach((count, code) => {
      const high = Math.min(Math.sqrt(count / most), 1) * height;
      context.fillRect((code * width) / 256, height - high, width / 256, high);
    });
  });
  context.globalCompositeOperation = "source-over";
};

const histogram = () => {
  one("#histogram-part").hidden = !isImage();
  if (!isImage()) return;
  const { counts, dark, bright } = counted(codes());
  plot(counts);
  one("#clipped").textContent = `clipped: ${brief(Number(dark.toPrecision(3)))} % black, ${brief(Number(bright.toPrecision(3)))} % white`;
};

// ---- focus peaking: as in a camera, from the contrast of the picture itself ---------------------------------------
const layer = (color) => { // pixels of the frame in a color, drawn over the picture
  const canvas = document.createElement("canvas");
  return {
    mark: (width, height, isMarked) => {
      [canvas.width, canvas.height] = [width, height];
      const image = new ImageData(width, height), pixels = new Uint32Array(image.data.buffer);
      for (let y = 1, at = width; y < height - 1; y += 1, at = y * width) {
        for (let x = 1; x < width - 1; x += 1) if (isMarked(at + x, width)) pixels[at + x] = color;
      }
      canvas.getContext("2d")?.putImageData(image, 0, 0);
    },
    clear: () => { canvas.width = 0; },
    draw: (context) => {
      const { left, top, scale } = studio.viewport;
      if (!canvas.width) return;
      context.imageSmoothingEnabled = false;
      context.drawImage(canvas, left, top, scale * canvas.width, scale * canvas.height);
    },
  };
};

const peaks = layer(0xff3232ff), outline = layer(0xff4dd2ff); // A B G R

const peaking = () => {
  if (!one("#peaking").checked || !isImage()) { peaks.clear(); return; }
  const { data, width, height } = codes();
  const green = (at) => data[4 * at + 1];
  peaks.mark(width, height, (at, row) => Math.abs(4 * green(at) - green(at - 1) - green(at + 1) - green(at - row) - green(at + row)) > PEAK);
};

// ---- the outline of the object in the panels, once one was chosen in the picture ------------------------------------
/** @type {{ ids: Float32Array, width: number, height: number } | null} */
let objects = null;
let chosen = -1; // -1: none

const outlined = () => {
  if (chosen < 0) studio.releases();
  if (objects === null || chosen < 0) { outline.clear(); return; }
  const { ids, width, height } = objects, isIn = (at) => ids[at] === chosen;
  outline.mark(width, height, (at, row) => isIn(at) && !(isIn(at - 1) && isIn(at + 1) && isIn(at - row) && isIn(at + row)));
  studio.grips(isIn, width, height);
};

studio.outlined = ({ width, height, values, revision }) => {
  objects = revision === studio.revision ? { ids: values, width, height } : null;
  outlined();
  studio.viewport.changed();
};

const choose = (index) => {
  chosen = index;
  studio.send({ outline: index >= 0 });
  if (index < 0) outlined();
  else one(`.objects li:nth-child(${index + 1}) button`)?.click();
};
studio.chosen = () => chosen;

/** @type {[number, number] | null} */
let awaited = null; // the pixel that was clicked
let pressed = [0, 0];
const clicks = () => {
  const stage = one("#stage");
  stage.addEventListener("pointerdown", (event) => { pressed = [event.clientX, event.clientY]; });
  stage.addEventListener("click", (event) => {
    const moved = Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) > 3;
    awaited = moved || studio.tool ? null : studio.viewport.pixelAt(event.clientX, event.clientY);
    if (awaited) studio.pin(awaited);
  });
};

studio.hearing.push((said) => {
  const { x, y, object_id: object } = said.inspected?.values ?? {};
  if (awaited === null || x !== awaited[0] || y !== awaited[1]) return;
  awaited = null;
  choose(object ?? -1);
});

// ---- this picture, as it is shown -------------------------------------------------------------------------------------
const picture = () => new Promise((done) => { one("#canvas").toBlob(done, "image/png"); });

const save = async () => {
  const link = document.createElement("a"), name = one("#title").textContent.replace(/\W+/g, "_") || "picture";
  link.href = URL.createObjectURL(await picture());
  link.download = `${name}-${studio.view.replace(" ", "_")}-${one("#badge").textContent.replace(/\W+/g, "_")}.png`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
};

const copy = async () => {
  try {
    await navigator.clipboard.write([new ClipboardItem({ "image/png": picture() })]);
  } catch (error) { studio.fail([`copy: ${problem(error)}`]); }
};

studio.measure = () => { // after each picture; while something is dragged, codes are not read back, which takes a while
  if (studio.rung === RUNG.DRAGGING) {
    objects = null;
    peaks.clear();
    outline.clear();
  } else {
    histogram();
    peaking();
  }
};

studio.overlays.push((context) => {
  peaks.draw(context);
  outline.draw(context);
});

studio.parts.push(() => {
  clicks();
  one("#peaking").addEventListener("change", () => { peaking(); studio.viewport.changed(); });
  one("#save-picture").addEventListener("click", save);
  one("#copy-picture").addEventListener("click", copy);
  on("keydown", (event) => {
    if (event.key !== "Escape" || one("dialog[open]")) return;
    if (chosen >= 0) choose(-1);
    studio.pin(null);
    studio.viewport.changed();
  });
});

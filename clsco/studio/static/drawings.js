// Small drawings beside the keys of shutter, aperture and PSF: what these do, as the renderer has it. Asked for while one is in sight.

import { all, studio } from "./shared.js";

const GAP = 4; // px between plots

/** @type {{ curve: number[], side: number, pupil: string, spreads: string[][] } | null} */
let latest = null;
/** @type {Set<any>} */
const inSight = new Set(); // canvases

const plot = (context, text, side, left, top, size) => { // light on dark; square roots, so that what is dim is seen
  const codes = atob(text), image = new ImageData(side, side), small = new OffscreenCanvas(side, side);
  for (let at = 0; at < side * side; at += 1) {
    const code = Math.max(Math.round(Math.sqrt(codes.charCodeAt(at) / 255) * 255), 17);
    image.data.set([code, code, code, 255], 4 * at);
  }
  small.getContext("2d")?.putImageData(image, 0, 0);
  context.drawImage(small, left, top, size, size);
};

/** @type {Record<string, (context: CanvasRenderingContext2D, width: number, height: number, data: NonNullable<typeof latest>) => void>} */
const DRAW = {
  curve: (context, width, height, { curve }) => { // over the time that the shutter is open
    const step = (width - 20) / curve.length, up = height - 12;
    context.fillStyle = "#3a6b45";
    curve.forEach((open, at) => context.fillRect(10 + at * step, 6 + (1 - open) * up, step + 0.5, open * up));
    context.fillStyle = "#e9eaec";
    context.fillRect(0, height - 6, width, 1);
  },
  pupil: (context, width, height, { pupil, side }) => plot(context, pupil, side, (width - height) / 2, 0, height),
  spreads: (context, width, height, { spreads, side }) => {
    const size = (height - GAP * (spreads.length - 1)) / spreads.length, across = (width - size) / (spreads[0].length - 1);
    spreads.forEach((row, down) => row.forEach((text, at) => plot(context, text, side, at * across, down * (size + GAP), size)));
  },
};

const draw = () => {
  if (latest === null) return;
  for (const canvas of inSight) {
    const context = canvas.getContext("2d");
    context.fillStyle = "#101113";
    context.fillRect(0, 0, canvas.width, canvas.height);
    DRAW[canvas.dataset.drawing]?.(context, canvas.width, canvas.height, latest);
  }
};

/** Asks for them, or for no more. */
studio.wantsDrawings = () => studio.send({ drawings: inSight.size > 0 });

const seen = new IntersectionObserver((changes) => {
  const before = inSight.size > 0;
  for (const { target, isIntersecting } of changes) inSight[isIntersecting ? "add" : "delete"](target);
  if (before !== inSight.size > 0) studio.wantsDrawings();
  draw();
});

studio.hearing.push((said) => {
  if (!said.drawings) return;
  latest = said.drawings;
  draw();
});

const observe = () => { for (const canvas of all("canvas[data-drawing]")) seen.observe(canvas); };

studio.parts.push(() => {
  observe();
  new MutationObserver((changes) => {
    if (changes.some((change) => [...change.addedNodes].some((node) => node instanceof Element && node.querySelector("[data-drawing]")))) observe();
  }).observe(document.body, { childList: true, subtree: true });
});

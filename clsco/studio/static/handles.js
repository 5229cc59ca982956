// Handles of the object that is outlined: one in its middle moves it at its depth, one above that along z.

import { one, stroked, studio, written } from "./shared.js";

const REACH = 13; // px from the middle of a handle within which the pointer takes hold of it
const ARM = 36; // px between the two
const COLOR = "#9fd4ff";
/** @typedef {[number, number]} Point */

/** @typedef {{ middle: Point, on: Point }} Grip */
/** @type {Grip | null} */
let grip = null; // pixels of the frame: the middle of what is seen of the object, and the nearest that shows it
/** @type {{ grip: Grip, by: Point } | null} */
let seen = null; // that of a picture that came while the object is held, and by how much it was dragged then

/** @param {(at: number) => boolean} isIn the object, by the number of a pixel */
studio.grips = (isIn, width, height) => {
  let count = 0, x = 0, y = 0;
  for (let at = 0; at < width * height; at += 1) if (isIn(at)) { count += 1; x += at % width; y += Math.floor(at / width); }
  if (!count) { grip = seen = null; return; }
  const middle = /** @type {Point} */ ([x / count, y / count]), away = (at) => Math.hypot(at % width - middle[0], Math.floor(at / width) - middle[1]);
  let best = -1;
  for (let at = 0; at < width * height; at += 1) if (isIn(at) && (best < 0 || away(at) < away(best))) best = at;
  const found = /** @type {Grip} */ ({ middle, on: [best % width, Math.floor(best / width)] }), by = /** @type {Point} */ (studio.heldBy().across);
  if (by[0] || by[1]) seen = { grip: found, by }; // the handles go with the pointer
  else [grip, seen] = [found, null];
};
studio.releases = () => { grip = seen = null; };

/** Where they are on the stage, with the object that is held. @returns {{ across: Point, along: Point } | null} */
const places = () => {
  if (grip === null) return null;
  const [x, y] = studio.viewport.place(...grip.middle), by = studio.heldBy();
  return { across: [x + by.across[0], y + by.across[1]], along: [x + by.across[0], y + by.across[1] - ARM + by.along] };
};

/** The handle at a point of the page: a pixel of its object, and whether it moves that along z. */
studio.handleAt = (x, y) => {
  const found = places(), box = one("#stage").getBoundingClientRect();
  if (found === null || grip === null) return null;
  const isNear = ([left, top]) => Math.hypot(x - box.left - left, y - box.top - top) <= REACH;
  return isNear(found.along) || isNear(found.across) ? { at: grip.on, along: isNear(found.along) } : null;
};

studio.dropped = ([across, down]) => { // the object is let go there, px of the frame away
  const by = studio.heldBy().across;
  if (seen !== null && seen.by[0] === by[0] && seen.by[1] === by[1]) grip = seen.grip;
  else if (grip !== null) grip.middle = [grip.middle[0] + across, grip.middle[1] + down];
  seen = null;
};

const drawn = (context, [x, y], arms) => { // a ring with arrows in it
  stroked(context, COLOR, [5, 2], () => {
    context.arc(x, y, REACH - 3, 0, 2 * Math.PI);
    for (const [dx, dy] of arms) {
      context.moveTo(x, y);
      context.lineTo(x + 7 * dx, y + 7 * dy);
      context.moveTo(x + 4 * dx - 3 * dy, y + 4 * dy - 3 * dx);
      context.lineTo(x + 7 * dx, y + 7 * dy);
      context.lineTo(x + 4 * dx + 3 * dy, y + 4 * dy + 3 * dx);
    }
  });
};

studio.overlays.push((context) => {
  const found = places();
  if (found === null) return;
  drawn(context, found.across, [[1, 0], [-1, 0], [0, 1], [0, -1]]);
  drawn(context, found.along, [[0, 1], [0, -1]]);
  context.font = "11px sans-serif";
  written(context, COLOR, "z", found.along[0] + REACH, found.along[1] + 4, 3);
});

studio.parts.push(() => {
  one("#stage").addEventListener("pointermove", (event) => {
    one("#stage").toggleAttribute("data-grip", studio.handleAt(event.clientX, event.clientY) !== null);
  });
});

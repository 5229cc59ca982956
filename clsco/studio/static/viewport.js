// An image that is zoomed and moved in an element of the page, by wheel, pointer and two fingers: the frame, and what is painted over.

import { on } from "./shared.js";

const LEAST = 0.02, MOST = 128; // CSS px per pixel of the image
const MARGIN = 16; // px of the element that are free beside an image that fits, unless the element is small

/** @typedef {{ x: number, y: number, apart: number }} Spread of two fingers */

export class Viewport {
  scale = 1; // CSS px per pixel of the image
  left = 0;
  top = 0; // of the image, in the element
  fitted = true;
  /** @type {Map<number, [number, number]>} */
  #fingers = new Map();
  /** @type {Spread | null} */
  #spread = null;
  #pans = false;

  /**
   * @param {() => any} element
   * @param {() => [number, number]} size of the image, px
   * @param {() => void} changed
   */
  constructor(element, size, changed) {
    this.element = element;
    this.size = size;
    this.changed = changed;
  }

  box() { return this.element().getBoundingClientRect(); }

  fit() {
    const { width, height } = this.box(), [columns, rows] = this.size();
    const margin = width < 600 ? 0 : MARGIN;
    this.scale = Math.min((width - margin) / columns, (height - margin) / rows);
    if (this.scale > 2) this.scale = Math.floor(this.scale * 4) / 4;
    this.left = (width - this.scale * columns) / 2;
    this.top = (height - this.scale * rows) / 2;
    this.fitted = true;
    this.changed();
  }

  refit() { if (this.fitted) this.fit(); else this.changed(); }

  /** Zooms about a point of the element, or its middle. */
  zoom(factor, x = this.box().width / 2, y = this.box().height / 2) {
    const to = Math.min(Math.max(this.scale * factor, LEAST), MOST);
    this.left = x - ((x - this.left) * to) / this.scale;
    this.top = y - ((y - this.top) * to) / this.scale;
    [this.scale, this.fitted] = [to, false];
    this.changed();
  }

  pan(x, y) { // as far as some of the image stays in sight
    const { width, height } = this.box(), [columns, rows] = this.size();
    const clamped = (at, count, room) => Math.min(Math.max(at, MARGIN - this.scale * count), room - MARGIN);
    [this.left, this.top, this.fitted] = [clamped(this.left + x, columns, width), clamped(this.top + y, rows, height), false];
    this.changed();
  }

  /** Column and row, from the image's corner, of a point of the page. @returns {[number, number]} */
  at(x, y) {
    const box = this.box();
    return [(x - box.left - this.left) / this.scale, (y - box.top - this.top) / this.scale];
  }

  /** The pixel at a point of the page, null beside the image. @returns {[number, number] | null} */
  pixelAt(x, y) {
    const [column, row] = this.at(x, y).map(Math.floor), [columns, rows] = this.size();
    return column >= 0 && row >= 0 && column < columns && row < rows ? [column, row] : null;
  }

  /** The point of the element that shows the middle of a pixel. @type {import("./shared.js").Place} */
  place = (column, row) => [this.left + (column + 0.5) * this.scale, this.top + (row + 0.5) * this.scale];

  /** Lays a wipe over the image, and tells its element where the image is. */
  lay(wipe) {
    const width = this.scale * this.size()[0], { style } = wipe.parentElement;
    [wipe.style.left, wipe.style.width] = [`${this.left - 16}px`, `${width + 32}px`]; // its middle goes from edge to edge
    wipe.style.setProperty("--share", String(wipe.value / 100));
    style.setProperty("--from", `${this.left}px`);
    style.setProperty("--to", `${this.left + width}px`);
    style.setProperty("--above", `${this.top}px`);
  }

  get isPinched() { return this.#fingers.size > 1; }

  /**
   * @param {(event: PointerEvent) => boolean} pans whether a pointer that goes down moves the image
   * @param {() => void} pinched called when a second finger comes
   */
  listen(pans, pinched = () => {}) {
    const isOurs = (target) => this.element()?.contains(target) && !target.closest("button, input, select, summary");
    on("wheel", (event, target) => {
      if (!isOurs(target)) return;
      event.preventDefault();
      const box = this.box();
      this.zoom(1.0015 ** -event.deltaY, event.clientX - box.left, event.clientY - box.top);
    }, { passive: false });
    on("pointerdown", (event, target) => {
      if (!isOurs(target)) return;
      this.element().setPointerCapture(event.pointerId);
      this.#fingers.set(event.pointerId, [event.clientX, event.clientY]);
      this.#pans = pans(event);
      if (!this.isPinched) return;
      this.#spread = this.#measured();
      pinched();
    });
    on("pointermove", (event) => this.#moved(event));
    for (const end of /** @type {const} */ (["pointerup", "pointercancel"])) on(end, (event) => this.#lifted(event));
  }

  #moved(event) {
    const last = this.#fingers.get(event.pointerId);
    if (last === undefined) return;
    this.#fingers.set(event.pointerId, [event.clientX, event.clientY]);
    if (this.#spread === null) {
      if (this.#pans) this.pan(event.clientX - last[0], event.clientY - last[1]);
      return;
    }
    if (!this.isPinched) return;
    const before = this.#spread, now = this.#spread = this.#measured(), box = this.box();
    this.pan(now.x - before.x, now.y - before.y);
    this.zoom(now.apart / Math.max(before.apart, 1), now.x - box.left, now.y - box.top);
  }

  #lifted(event) {
    this.#fingers.delete(event.pointerId);
    if (this.#fingers.size === 0) this.#spread = null;
  }

  /** @returns {Spread} */
  #measured() {
    const [a, b] = [...this.#fingers.values()];
    return { x: (a[0] + b[0]) / 2, y: (a[1] + b[1]) / 2, apart: Math.hypot(a[0] - b[0], a[1] - b[1]) };
  }
}

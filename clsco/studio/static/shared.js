// The object by which the modules of the page and the tests know one another; and the page's elements,
// which Python draws: their kinds are not known here.

/**
 * @typedef {ReturnType<typeof import("./protocol.js").opened>["picture"] & { values?: Float32Array, legend?: Legend }} Picture
 * @typedef {{ least: string, most: string, about: string, color: (t: number) => number[] }} Legend
 * @typedef {(x: number, y: number) => [number, number]} Place of a pixel of the frame on the stage
 */

/** @type {(selector: string) => any} */
export const one = (selector) => document.querySelector(selector);
/** @type {(selector: string) => any[]} */
export const all = (selector) => [...document.querySelectorAll(selector)];
/** Controls of a key of the scene. @type {(path: string) => any[]} */
export const sameKey = (path) => all(`[data-path="${CSS.escape(path)}"]`);

/**
 * Has events of a kind handled wherever they are, as elements come and go.
 * @template {keyof DocumentEventMap} K
 * @param {K} kind
 * @param {(event: DocumentEventMap[K], target: any) => unknown} handle
 * @param {AddEventListenerOptions} [options]
 */
export const on = (kind, handle, options) => {
  document.addEventListener(kind, (event) => { handle(event, event.target); }, options);
};

/** A new element. @type {(tag: string, properties?: object, ...content: (Node | string)[]) => any} */
export const made = (tag, properties = {}, ...content) => {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...content);
  return element;
};

/** Has a button show and hide a part of the page. */
export const toggles = (button, part, hidden = () => {}) => one(button).addEventListener("click", () => {
  one(part).hidden = !one(part).hidden;
  one(button).setAttribute("aria-pressed", String(!one(part).hidden));
  if (one(part).hidden) hidden();
});

const EDGE = "#141517"; // about what is drawn over the picture, so that it is seen on light and dark
export const MARK = "#ffd24d";

/** Strokes a path in a color, with an edge; both widths in px. */
export const stroked = (context, color, [edge, width], trace) => {
  for (const [wide, style] of [[edge, EDGE], [width, color]]) {
    [context.lineWidth, context.strokeStyle] = [wide, style];
    context.beginPath();
    trace();
    context.stroke();
  }
};

/** Writes a text in a color, with an edge. */
export const written = (context, color, text, x, y, edge = 4) => {
  [context.lineWidth, context.strokeStyle, context.fillStyle] = [edge, EDGE, color];
  context.strokeText(text, x, y);
  context.fillText(text, x, y);
};

/** Gives an element its text; one that has it is not laid out again. */
export const reword = (element, text) => { if (element.textContent !== text) element.textContent = text; };

/** What went wrong, in words. @returns {string} */
export const problem = (error) => error instanceof Error ? error.message : String(error);

/** @type {Record<string, any>} */
const calls = {}; // what a module offers to others that it must not wait for

const state = {
  painted: /** @type {[number, number, number][]} */ ([]), // [revision, rung, time], the latest 500
  hearing: /** @type {((said: any) => void)[]} */ ([]), // functions of what the server says
  // functions that draw over the picture
  overlays: /** @type {((context: CanvasRenderingContext2D, place: Place) => void)[]} */ ([]),
  parts: /** @type {(() => void)[]} */ ([]), // functions that begin the other modules' work
  sent: /** @type {Map<string, unknown>} */ (new Map()), // values by path, since the server was asked for its scene
  revision: -1, rung: -1, view: "color", index: 0, right: false, tab: "", tool: "",
  moment: /** @type {number | null} */ (null),
  values: /** @type {Record<string, any>} */ ({}),
  faults: /** @type {Record<string, string>} */ ({}),
};

/** @type {typeof state & typeof calls} */
export const studio = Object.assign(calls, state);
Object.assign(window, { studio }); // for the tests

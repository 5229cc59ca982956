// The strip of the lens: iris, ruler of depth with the V of the blur, and the point in the picture.

import { brief, placeOf } from "./scales.js";
import { all, made, one, reword, stroked, studio } from "./shared.js";

const SHARP = 0.5; // px, |R| below which a point is in focus
const TOP = 40; // px of blur disc up to which the V is drawn to scale
const NEAREST = 1.05; // focal lengths, which the ruler does not reach
const ROUND = 12, WIDEST = 1.4; // blades of a round iris; stops below are shown where the scene has them
const FOCUS = "camera.focus_distance", STOP = "camera.f_number";
const rounded = (value) => brief(Number(value.toPrecision(Math.max(3, Math.ceil(Math.log10(value))))));
const marked = (value) => (value >= 1000 ? `${brief(Number((value / 1000).toPrecision(2)))} m` : brief(Number(value.toPrecision(3))));
const slider = () => one(`#ruler [data-path="${FOCUS}"]`);

const svg = (parts) => parts.map(([tag, attributes, text = ""]) => {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, String(value));
  element.textContent = text;
  return element;
});

// ---- iris -------------------------------------------------------------------------------------------------------
const BEYOND = 60; // where blades end
let widest = WIDEST; // least f-number that was seen

/** Blades, each from corner to corner of its edge, and on along it: those of a polygon, or many round ones. */
const blades = ({ shape, blades: count, blade_curvature: curvature, rotation }, radius) => {
  const [n, bulge, turn] = shape === "polygon" ? [count, curvature, rotation] : [ROUND, 1, 0], half = Math.PI / n;
  const chord = 2 * radius * Math.sin(half), arc = chord / 2 / Math.sin(2 * Math.atan(Math.abs(bulge) * Math.tan(half / 2)));
  const edge = bulge ? `A ${arc} ${arc} 0 0 ${Number(bulge > 0)}` : "L", x = radius * Math.cos(half), y = chord / 2;
  return Array.from({ length: n }, (_, k) => ["path", {
    d: `M ${x} ${-y} ${edge} ${x} ${y} L ${x} ${BEYOND} L ${BEYOND} ${BEYOND} L ${BEYOND} ${-y} Z`,
    transform: `rotate(${-turn - (360 * k) / n})`, fill: "var(--blade)", stroke: "var(--blade-edge)", "stroke-width": 0.8,
  }]);
};

let drawn = ""; // of what the iris is
const iris = ({ focal_length: f, aperture, opening }) => {
  if (drawn === (drawn = JSON.stringify([f, aperture, opening]))) return;
  widest = Math.min(widest, f / aperture);
  const radius = 8 + 40 * Math.min((widest * aperture) / f, 1), { shape, obstruction, squeeze, image } = opening;
  const ring = (r, fill, more = {}) => ["circle", { r, fill, ...more }];
  const picture = { x: -radius, y: -radius, width: 2 * radius, height: 2 * radius, transform: `rotate(${-opening.rotation})` };
  const parts = /** @type {any[]} */ ([ring(54, "var(--black)"), ring(radius + 3, "var(--glow)"), ...blades(opening, radius)]);
  if (shape === "ring") parts.push(ring(radius * obstruction, "var(--blade)"));
  if (shape === "image") { // as bright as it lets light through
    const href = `thumbnail?tab=${studio.tab}&path=aperture.image&of=${encodeURIComponent(image)}`;
    parts.push(ring(radius + 1, "var(--glow)"), ["image", { ...picture, href, class: "transmission" }]);
  }
  one("#blades").replaceChildren(...svg([
    ["g", { transform: `scale(${1 / squeeze} 1)` }], ring(57, "none", { stroke: "var(--panel)", "stroke-width": 7 }),
    ring(57, "none", { stroke: "var(--edge)", "stroke-width": 2 }),
  ]));
  one("#blades g").append(...svg(parts));
  reword(one("#open"), `${brief(Number(aperture.toPrecision(3)))} mm open`);
  for (const button of all("#stops button")) {
    const stop = Number(button.dataset.stop);
    button.setAttribute("aria-checked", String(Math.abs(stop - f / aperture) < 0.01));
    button.hidden = stop < WIDEST && stop < widest - 0.01;
  }
};

// ---- ruler: dioptres from left to right, to infinity -----------------------------------------------------------------
/** @type {[string, number, number | null, number | null, string][]} */
let objects = []; // name, nearest, middle and farthest depth in mm, color

const NEARER = { 1: 0.8, 8: 6 / 8, 6: 5 / 6, 5: 4 / 5, 4: 3 / 4, 3: 2 / 3, 2: 1 / 2 }; // to the next round distance, by the digit

/** Round distances from far to near, as far as there is room, and whether there is room for their names. */
const marks = (at, middle, most) => {
  const found = /** @type {[number, boolean][]} */ ([]);
  let named = at(0) - 36 + 44, last = at(0);
  for (let depth = 10 ** Math.ceil(Math.log10(40 / most)); depth * most > 1 && found.length < 60;) {
    const x = at(1 / depth), isNamed = named - x > 44 && Math.abs(x - middle) > 18;
    if (last - x > 22) {
      found.push([depth, isNamed]);
      last = x;
      if (isNamed) named = x;
    }
    depth *= NEARER[Math.round(depth / 10 ** Math.floor(Math.log10(depth) + 1e-9))];
  }
  return found;
};

const ruler = (lens) => {
  const { clientWidth: width, clientHeight: height } = one("#ruler"), most = -Number(slider().min);
  if (!width || !lens) return;
  const tight = height < 70, top = tight ? 14 : 24, base = height - (tight ? 16 : 32);
  const at = (power) => 8 + (width - 16) * (1 - Math.min(Math.max(power, 0), most) / most);
  const inverse = (depth) => (depth === null ? 0 : 1 / depth);
  const power = inverse(lens.focus), near = inverse(lens.near), blur = SHARP / (near - power); // px of |R| per 1/mm
  const tall = (base - top) / (TOP / 2 + 10), high = (each) => Math.max(top, base - Math.abs(each - power) * blur * tall);
  const reach = (base - top) / tall / blur, ends = [most, Math.min(most, power + reach), power, Math.max(0, power - reach), 0];
  const v = ends.map((each) => `${at(each)} ${high(each)}`).join(" L "), middle = at(power), parts = /** @type {any[]} */ ([]);
  const text = (x, y, words, attributes = {}) => parts.push(["text", { x, y, "text-anchor": "middle", ...attributes }, words]);
  const line = (x1, y1, x2, y2, stroke, more = {}) => parts.push(["line", { x1, y1, x2, y2, stroke, ...more }]);
  const left = at(near), wide = Math.max(at(inverse(lens.far)) - left, 3);
  line(at(most), base, at(0), base, "var(--field-edge)");
  for (const [depth, isNamed] of marks(at, middle, most)) {
    const x = at(1 / depth);
    line(x, base, x, base + 5, "var(--field-edge)");
    if (isNamed) text(x, base + 16, marked(depth));
  }
  text(at(0), base + 16, "∞", { "text-anchor": "end" });
  const room = (44 * most * 1000) / (width - 16), power10 = 10 ** Math.floor(Math.log10(room)); // dioptres that a name takes
  const unit = tight ? Infinity : power10 * ([1, 2, 5].find((each) => each * power10 >= room) ?? 10);
  for (let each = unit; each < most * 1000; each += unit) text(at(each / 1000), base + 29, `${brief(each)} D`, { class: "dioptre" });
  for (const disc of tight ? [] : [TOP / 2, TOP]) {
    const y = base - (disc / 2) * tall;
    line(at(most), y, at(0), y, "var(--text)", { "stroke-opacity": 0.12 });
    text(at(most) + 4, y - 3, `${disc} px`, { "text-anchor": "start" });
  }
  bars(parts, at, base, tight ? [10] : [10, 22], width);
  const [below, fixed, above] = all("#ruler svg"), key = JSON.stringify(parts);
  below.replaceChildren(...svg([
    ["path", { d: `M ${v} L ${at(0)} ${base} L ${at(most)} ${base} Z`, fill: "var(--soft)" }],
    ["path", { d: `M ${v}`, fill: "none", stroke: "var(--accent)", "stroke-opacity": 0.75 }],
    ["rect", { x: left, y: top, width: wide, height: base - top, fill: "var(--accent)", opacity: 0.3, id: "sharp" }],
  ]));
  if (fixed.dataset.of !== key) fixed.replaceChildren(...svg(parts)); // its texts, which take long, are not laid out with the others
  fixed.dataset.of = key;
  above.replaceChildren(...svg([
    ["line", { x1: middle, y1: top - 4, x2: middle, y2: base, stroke: "var(--accent)", "stroke-width": 2 }],
    ["circle", { cx: middle, cy: base + 2, r: 9, fill: "var(--accent)", stroke: "var(--panel)", "stroke-width": 2 }],
  ]));
};

/** Each object from its nearest to its farthest depth; names that collide are left out, first those of long bars. */
const bars = (parts, at, base, levels, width) => {
  const occupied = levels.map(() => /** @type {number[][]} */ ([])), names = [];
  const ends = objects.map(([name, near, depth, far, color]) => ({ name, depth, color, left: at(near ? 1 / near : 0), right: at(far ? 1 / far : 0) }));
  const isLong = ({ left, right }) => Number(right - left > width / 4);
  for (const { name, depth, color, left, right } of ends.sort((a, b) => isLong(a) - isLong(b))) {
    const middle = (left + right) / 2, half = 3.2 * name.length, x = Math.min(Math.max(middle, half + 12), width - half - 2);
    parts.unshift(["rect", { x: Math.min(left, width - 14), y: base - 5, width: Math.max(6, right - left), height: 5, rx: 2, fill: color }]);
    const level = occupied.findIndex((others) => others.every((other) => Math.abs(x - other[0]) > half + other[1] + 14));
    if (level < 0) continue;
    occupied[level].push([x, half]);
    parts.push(["line", { x1: middle, x2: middle, y1: levels[level] + 4, y2: base - 6, stroke: color, "stroke-dasharray": "1 3" }]);
    parts.push(["circle", { cx: x - half - 6, cy: levels[level] - 4, r: 3.5, fill: color }]);
    const button = made("button", { type: "button", tabIndex: -1, title: "Focus on it", onclick: () => studio.set(FOCUS, depth ?? "inf") }, name);
    button.setAttribute("aria-label", `Focus on ${name}`);
    [button.style.left, button.style.top] = [`${x}px`, `${levels[level] - 16}px`];
    names.push(button);
  }
  const key = names.map((each) => each.style.cssText + each.textContent).join();
  if (one("#names").dataset.of !== key) one("#names").replaceChildren(...names);
  one("#names").dataset.of = key;
};

const draw = () => {
  if (studio.lens) iris(studio.lens);
  ruler(studio.lens);
};

let scene = ""; // that the objects are of
studio.hearing.push(({ lens, overview, file, title }) => {
  const ranges = overview?.ranges;
  if (lens && scene !== (scene = `${file} ${title}`)) [objects, point] = [[], null]; // another one was opened
  if (ranges) objects = ranges.sort((a, b) => (a[1] ?? Infinity) - (b[1] ?? Infinity)); // from near to far
  if (lens) {
    studio.lens = lens;
    const near = rounded(lens.near), far = lens.far === null ? "mm to infinity" : `to ${rounded(lens.far)} mm`;
    reword(one("#in-focus"), far === `to ${near} mm` ? `sharp at ${near} mm` : `sharp from ${near} ${far}`);
    reword(one("#deep"), lens.far === null ? "" : `${brief(Number((lens.far - lens.near).toPrecision(2)))} mm deep`);
    reword(one("#dioptres"), lens.focus === null ? "0 D" : `${(1000 / lens.focus).toFixed(2)} D`);
  }
  if (lens || ranges) { end(); draw(); }
});

const end = () => { // the near end of the ruler: beyond the focus, what is sharp and the objects, in steps; not while it is dragged
  const range = slider(), { lens } = studio, near = Math.min(...objects.map(([, depth]) => depth ?? Infinity));
  if (!lens || range.matches(":active")) return;
  const most = Math.max(2 / (lens.focus ?? lens.near), 1.1 / lens.near, 1.2 / near);
  range.min = -Math.min(2 ** (Math.ceil(4 * Math.log2(most)) / 4), 1 / (NEAREST * lens.focal_length));
  range.max = 0;
  range.dataset.step = "2e-5"; // 0.02 dioptres
  range.value = placeOf(range, lens.focus ?? Infinity);
};

// ---- the point in the picture, in a sentence -----------------------------------------------------------------------
/** @type {{ x: number, y: number, depth: number | null, radius: number } | null} */
let point = null;
studio.describe = (values) => {
  const { x, y, object, depth, blur_radius: radii } = values, radius = Array.isArray(radii) ? radii[1] : radii, { focus } = studio.lens ?? {};
  point = typeof radius === "number" ? { x, y, depth, radius } : null;
  studio.viewport.changed();
  if (typeof radius !== "number") { reword(one("#who"), "Nothing"); reword(one("#what"), "no surface"); return; }
  const disc = 2 * Math.abs(radius), kind = disc < 2 * SHARP ? "sharp" : disc < 4 ? "nearly sharp" : "soft";
  const name = object ? object[0].toUpperCase() + object.slice(1) : "Surface", isFar = depth === null;
  const gap = focus ? `${brief(Number(Math.abs(depth - focus).toPrecision(2)))} mm ${depth > focus ? "behind" : "before"} the focus` : "before the focus";
  reword(one("#who"), `${name}, ${kind}`);
  reword(one("#what"), `${isFar ? "at infinity" : `${marked(depth)}${depth < 1000 ? " mm" : ""}: ${gap}`}, blur disc ${disc.toFixed(1)} px`);
};

studio.overlays.push((context, place) => { // a ring as large as the blur of the point
  if (point === null || studio.tool) return;
  const [x, y] = place(point.x, point.y), radius = Math.max(4, Math.abs(point.radius) * studio.viewport.scale);
  const color = getComputedStyle(one("#stage")).getPropertyValue("--glow");
  stroked(context, color, [3.5, 1.5], () => context.arc(x, y, radius, 0, 2 * Math.PI));
  if (studio.isPinned()) stroked(context, color, [4, 2], () => context.arc(x, y, 1, 0, 2 * Math.PI));
});

studio.parts.push(() => {
  new ResizeObserver(draw).observe(one("#ruler"));
  one("#stops").addEventListener("click", ({ target }) => { if (target.dataset.stop) studio.set(STOP, Number(target.dataset.stop)); });
});

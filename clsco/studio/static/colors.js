// Colors of what is no image: of each view of floats, (rows, columns[, channels]), its pixels and its legend.

const polynomial = [ // viridis, to a code or two
  [0.2777, 0.0054, 0.3341], [0.1051, 1.4046, 1.3846], [-0.3309, 0.2148, 0.0951], [-4.6342, -5.7991, -19.3324],
  [6.2283, 14.1799, 56.6906], [4.7764, -13.7451, -65.353], [-5.4355, 4.6459, 26.3124],
];
const viridis = (t) => [0, 1, 2].map((channel) => {
  const value = polynomial.reduceRight((sum, factors) => sum * t + factors[channel], 0);
  return Math.round(255 * Math.min(Math.max(value, 0), 1));
});
const LEVELS = 512;
const table = (color) => Array.from({ length: LEVELS }, (_, at) => color(at / (LEVELS - 1)));
const mixed = (a, b, t) => a.map((value, at) => Math.round(value + t * (b[at] - value)));
// Blue in front of the focal surface, orange behind it: told apart by all kinds of color vision.
const diverging = (t) => (t < 0.5 ? mixed([245, 245, 245], [27, 95, 190], 1 - 2 * t) : mixed([245, 245, 245], [214, 96, 0], 2 * t - 1));
const PALETTE = [[86, 180, 233], [230, 159, 0], [0, 158, 115], [240, 228, 66], [0, 114, 178], [213, 94, 0], [204, 121, 167], [160, 160, 160]];
const VIRIDIS = table(viridis), DIVERGING = table(diverging);
const short = (value) => String(Number(value.toPrecision(4)));

const wheel = (angle, length) => { // hue by direction, white for none
  const hue = ((angle / (2 * Math.PI)) % 1 + 1) % 1 * 6, part = hue - Math.floor(hue);
  const full = [[1, part, 0], [1 - part, 1, 0], [0, 1, part], [0, 1 - part, 1], [part, 0, 1], [1, 0, 1 - part]][Math.floor(hue) % 6];
  return full.map((value) => Math.round(255 * (1 - length * (1 - value))));
};

const extremes = (values) => {
  let least = Infinity, most = -Infinity;
  for (const value of values) if (Number.isFinite(value)) { if (value < least) least = value; if (value > most) most = value; }
  return least <= most ? [least, most] : [0, 1];
};

const each = (width, height, color) => {
  const data = new Uint8ClampedArray(4 * width * height);
  for (let y = 0, at = 0; y < height; y += 1) {
    for (let x = 0; x < width; x += 1, at += 1) {
      const [r, g, b] = color(at, x, y);
      data[4 * at] = r; data[4 * at + 1] = g; data[4 * at + 2] = b; data[4 * at + 3] = 255;
    }
  }
  return data;
};

const nothing = (x, y) => ((x + y) % 8 < 2 ? [90, 90, 90] : [40, 40, 40]); // hatched

const bright = (unit, about) => (values, width, height) => { // the brighter, the more; of colors the green
  const [least, most] = extremes(values), channels = values.length / (width * height), span = (LEVELS - 1) / (most - least || 1);
  const data = each(width, height, (at, x, y) => {
    const value = values[channels * at + (channels > 1 ? 1 : 0)];
    return Number.isFinite(value) ? VIRIDIS[Math.round((value - least) * span)] : nothing(x, y);
  });
  return { data, legend: { least: `${short(least)} ${unit}`, most: `${short(most)} ${unit}`, about, color: viridis } };
};

const VIEWS = {
  depth: bright("mm", "depth Z; hatched: nothing there"),
  "blur radius": (values, width, height) => {
    const [least, most] = extremes(values), size = Math.max(Math.abs(least), Math.abs(most), 0.5), half = (LEVELS - 1) / 2;
    const inFocus = (at) => Math.abs(values[at]) < 0.5;
    const data = each(width, height, (at, x, y) => {
      if (!Number.isFinite(values[at])) return nothing(x, y);
      const edge = inFocus(at) !== inFocus(x ? at - 1 : at) || inFocus(at) !== inFocus(y ? at - width : at);
      if (edge) return [0, 0, 0];
      const color = DIVERGING[Math.round(half * (1 + values[at] / size))];
      return values[at] < 0 && (x + y) % 6 === 0 ? mixed(color, [0, 0, 0], 0.35) : color;
    });
    const about = "blur radius R; striped: in front of the focal surface; hatched dark: nothing there; outlined: |R| < 0.5 px";
    return { data, legend: { least: `−${short(size)} px`, most: `${short(size)} px`, about, color: diverging } };
  },
  flow: (values, width, height) => {
    let most = 1e-6;
    for (let at = 0; at < values.length; at += 2) {
      const length = Math.hypot(values[at], values[at + 1]);
      if (Number.isFinite(length) && length > most) most = length;
    }
    const data = each(width, height, (at) => {
      const u = values[2 * at], v = values[2 * at + 1];
      return Number.isFinite(u + v) ? wheel(Math.atan2(v, u), Math.min(Math.hypot(u, v) / most, 1)) : [40, 40, 40];
    });
    const about = `flow to the next frame; hue: direction, from right by down; at most ${short(most < 1e-5 ? 0 : most)} px`;
    return { data, legend: { least: "→ 0°", most: "360°", about, color: (t) => wheel(2 * Math.PI * t, 1) } };
  },
  normal: (values, width, height) => ({
    data: each(width, height, (at) => [0, 1, 2].map((axis) => 127.5 * (1 + values[3 * at + axis]))),
    legend: { least: "−1", most: "1", about: "normal: x red, y green, z into the scene blue", color: (t) => [255 * t, 255 * t, 255 * t] },
  }),
  id: (values, width, height) => ({
    data: each(width, height, (at) => (values[at] < 0 ? [0, 0, 0] : PALETTE[values[at] % PALETTE.length])),
    legend: { least: "0", most: "7", about: "position in the list of objects; black: none", color: (t) => PALETTE[Math.min(Math.floor(8 * t), 7)] },
  }),
  mask: (values, width, height) => ({ data: each(width, height, (at) => (values[at] ? [255, 255, 255] : [0, 0, 0])) }),
  missing: (values, width, height) => ({ data: each(width, height, (at) => (values[at] ? [255, 255, 255] : [0, 0, 0])) }),
  raw: (values, width, height) => {
    const [least, most] = extremes(values), channels = values.length / (width * height), gray = (t) => [255 * t, 255 * t, 255 * t];
    const code = (at, k) => 255 * (values[channels * at + (k % channels)] - least) / (most - least || 1);
    const data = each(width, height, (at) => [code(at, 0), code(at, 1), code(at, 2)]);
    return { data, legend: { least: `${least} DN`, most: `${most} DN`, about: "codes of the sensor; of a mosaic one for each pixel", color: gray } };
  },
  noise: bright("e−", "standard deviation of the noise, in color that of green"),
};

export const colored = (view, values, width, height) => VIEWS[view](values, width, height);

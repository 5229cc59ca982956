// Scales of sliders: places on them, as clsco/studio/forms.py has them, and the values there; and numbers in words.

const THIRDS = [1, 1.1, 1.2, 1.4, 1.6, 1.8, 2, 2.2, 2.5, 2.8, 3.2, 3.5, 4, 4.5, 5, 5.6, 6.3, 7.1, 8, 9, 10, 11, 13, 14, 16, 18, 20, 22];
const DRAGGED = 4, SHOWN = 5; // digits of what is dragged, and of what is shown in a box that nobody types in

const stop = (place) => THIRDS[Math.round(place)] ?? 2 ** (Math.round(place) / 6); // as they are engraved

/** @type {Record<string, { place: (value: number) => number, value: (place: number) => number }>} */
const SCALES = {
  inverse: { place: (value) => -1 / value, value: (place) => (place > -1e-6 ? Infinity : -1 / place) }, // dioptres, far to the right
  log: { place: Math.log10, value: (place) => 10 ** place },
  stops: { place: (value) => 6 * Math.log2(value), value: stop },
};

export const placeOf = (slider, value) => SCALES[slider.dataset.scale]?.place(value === "inf" ? Infinity : Number(value)) ?? value;

/** Value of a slider at a place, rounded to what can be told apart by dragging it. */
export const valueAt = (slider, place = Number(slider.value)) => {
  const scale = SCALES[slider.dataset.scale], step = Number(slider.dataset.step);
  const value = scale && Number(scale.value(place).toPrecision(DRAGGED));
  if (scale) return value === Infinity ? "inf" : value;
  return step ? Number((Math.round(place / step) * step).toPrecision(12)) : place;
};

/** A number with as many digits as tell it apart, and no more. */
export const full = (value) => (typeof value === "number" ? String(Number(value.toPrecision(12))) : String(value ?? ""));

/** A number with the digits that mean something: whole ones have all. */
export const brief = (value) => {
  if (typeof value !== "number" || Number.isInteger(value)) return full(value);
  return String(Number(value.toPrecision(Math.max(SHOWN, Math.ceil(Math.log10(Math.abs(value)))))));
};

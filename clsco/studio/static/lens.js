// The strip above the picture: what the lens has in focus, and the lens drawn small.

import { brief, placeOf } from "./scales.js";
import { all, one, reword, studio } from "./shared.js";

const GLASS = 78, AXIS = 15; // px in the drawing
const inverse = (distance) => (distance === null ? 0 : 1 / distance); // null: infinite
const distance = (value) => (value === null ? "∞" : brief(Number(value.toPrecision(4))));

const draw = ({ focus, near, far, focal_length: f, aperture }) => { // before the lens by the inverse of the distance
  const canvas = one("#lens-small"), context = canvas.getContext("2d"), { width, height } = canvas;
  const most = 1.6 * Math.max(inverse(near), inverse(focus), 1e-9), at = (value) => 2 + ((GLASS - 12) * inverse(value)) / most;
  const half = Math.min(Math.max((13 * aperture * 1.4) / f, 1), 13);
  context.clearRect(0, 0, width, height);
  context.fillStyle = "#3a6b45";
  context.fillRect(at(far), 2, Math.max(at(near) - at(far), 1), height - 4);
  context.fillStyle = "rgb(255 180 87 / 45%)"; // the light of a point in focus
  context.beginPath();
  for (const [x, y] of [[at(focus), AXIS], [GLASS, AXIS - half], [width - 6, AXIS], [GLASS, AXIS + half]]) context.lineTo(x, y);
  context.fill();
  context.strokeStyle = "#6cb6ff";
  context.beginPath();
  context.ellipse(GLASS, AXIS, 4, 14, 0, 0, 2 * Math.PI);
  context.stroke();
  context.strokeStyle = "#e9eaec"; // blades and detector
  context.beginPath();
  for (const [x, y0, y1] of [[GLASS, 0, AXIS - half], [GLASS, AXIS + half, height], [width - 6, 3, height - 3]]) {
    context.moveTo(x, y0);
    context.lineTo(x, y1);
  }
  context.stroke();
};

studio.hearing.push(({ lens }) => {
  if (!lens) return;
  studio.lens = lens;
  const depth = lens.far === null ? "to infinity" : `${brief(Number((lens.far - lens.near).toPrecision(3)))} mm deep`;
  reword(one("#in-focus"), `sharp ${distance(lens.near)} – ${distance(lens.far)} mm, ${depth}`);
  for (const slider of all('input[type=range][data-path="camera.focus_distance"]')) { // its ends follow the focal length
    [slider.min, slider.max] = lens.ends.map((end) => placeOf(slider, end));
    slider.dataset.step = String((Number(slider.max) - Number(slider.min)) / 200);
    if (typeof studio.values[slider.dataset.path] === "number") slider.value = placeOf(slider, studio.values[slider.dataset.path]);
  }
  draw(lens);
  studio.viewport.changed();
});

// Pictures as they come, decoded; the views beside the picture, drawn small; and the values of panels that are closed.

import { colored } from "./colors.js";
import { ENCODING } from "./protocol.js";
import { brief } from "./scales.js";
import { all, one, reword, studio } from "./shared.js";

export const decoded = (picture, payload) => createImageBitmap(
  new Blob([payload], { type: picture.encoding === ENCODING.JPEG ? "image/jpeg" : "image/png" }),
  { colorSpaceConversion: "none", premultiplyAlpha: "none" });

export const plane = (picture, payload) => {
  const values = new Float32Array(payload.buffer, payload.byteOffset);
  picture.values = values;
  const { data, legend } = colored(picture.view, values, picture.width, picture.height);
  picture.legend = legend;
  return createImageBitmap(new ImageData(data, picture.width, picture.height));
};

studio.stale = (is) => { for (const tab of all("#views [data-view]")) tab.toggleAttribute("data-stale", is); };
studio.hearing.push(({ overview }) => { // small views, all of one frame
  if (!overview) return;
  studio.stale(false);
  for (const [view, [width, height, text]] of Object.entries(overview.views)) {
    const payload = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const encoding = view === "color" || view === "sharp" ? ENCODING.JPEG : ENCODING.FLOAT32, picture = { view, width, height, encoding };
    (encoding === ENCODING.JPEG ? decoded(picture, payload) : plane(picture, payload)).then((image) => {
      if (view === "mask") { studio.values.gaps = picture.values?.includes(0); summed(); }
      thumbnail(view, image);
    });
  }
});
const thumbnail = (view, canvas) => { // small, beside the picture
  const small = one(`[data-view="${view}"] canvas`), scale = Math.max(small.width / canvas.width, small.height / canvas.height);
  const [width, height] = [scale * canvas.width, scale * canvas.height], context = small.getContext("2d");
  context.imageSmoothingQuality = "high";
  context.drawImage(canvas, (small.width - width) / 2, (small.height - height) / 2, width, height);
};

/** Labels of fields, and the path and default of each of their boxes. @type {() => [any, [string, any][]][]} */
export const defaults = () => all("[data-default]").map((label) => {
  const normal = [JSON.parse(label.dataset.default)].flat(2), boxes = [...label.parentElement.querySelectorAll("[data-path]:not([type=range])")];
  return [label, boxes.map(({ dataset }, k) => [dataset.path, normal[k] ?? null])];
});

let awaits = 0;
/** Shows the values of closed panels, and which views have no meaning for the scene, soon: a drag changes much. */
export const summed = () => { awaits ||= setTimeout(sum, 40); };
const sum = () => {
  awaits = 0;
  const { values } = studio, shapes = one("[data-path$='.shape']:checked")?.closest("label").textContent;
  for (const place of all("[data-brief]")) {
    const path = place.dataset.brief, value = values[path];
    if (path === "moves") reword(place, value ? "moves" : "still");
    else if (path.endsWith(".shape")) reword(place, shapes ?? "");
    else reword(place, typeof value === "number" ? `${brief(value)} mm` : String(value ?? "").split("/").at(-1));
  }
  for (const [label, boxes] of defaults()) { // a dot where a value is not the default
    label.toggleAttribute("data-other", boxes.some(([path, normal]) => values.given?.includes(path) && values[path] !== normal));
  }
  values.warps = values["motion.warp"] === "forward";
  for (const tab of all("[data-rare]")) tab.toggleAttribute("data-rare-now", !values[tab.dataset.rare]);
  const more = all("[data-rare-now]").length, isOpen = one("#views").hasAttribute("data-all");
  reword(one("#more span"), isOpen ? "Fewer" : `${more} more`);
  one("#more").hidden = !more;
};

// Images of the forms: chosen, dropped, sent to the server and shown small; and texts that are copied.

import { all, on, one, problem, studio } from "./shared.js";

const at = (name, path) => one(`[data-${name}="${CSS.escape(path)}"]`);

/** Keeps an image in the studio's folder; gives its name there. */
studio.uploaded = async (file) => {
  const kind = file.name.split(".").pop().toLowerCase();
  const place = `texture?tab=${studio.tab}&kind=${encodeURIComponent(kind)}`;
  const answer = await fetch(place, { method: "POST", body: file });
  const { name, error } = await answer.json();
  if (error) throw new Error(error);
  return name;
};

const upload = async (path, file) => {
  try {
    studio.put(path, await studio.uploaded(file));
  } catch (error) {
    const fault = at("fault", path);
    if (fault !== null) [fault.textContent, fault.hidden] = [problem(error), false];
  }
};

const copy = async (button) => {
  await navigator.clipboard.writeText(button.dataset.copy);
  const before = button.textContent;
  button.textContent = "Copied";
  setTimeout(() => { button.textContent = before; }, 1500);
};

on("click", (_, target) => {
  const browse = target.closest("[data-browse]"), button = target.closest("[data-copy]");
  if (browse) at("upload", browse.dataset.browse)?.click();
  if (button) copy(button);
});
on("change", (_, target) => {
  const { upload: path } = target.dataset ?? {}; // "": of no key
  if (path && target.files.length) upload(path, target.files[0]);
});
for (const kind of /** @type {const} */ (["dragover", "drop"])) {
  on(kind, (event, target) => {
    event.preventDefault(); // a file that misses the place must not replace the page
    const place = target.closest("[data-drop]"), files = event.dataTransfer?.files;
    if (kind === "drop" && place && files?.length) upload(place.dataset.drop, files[0]);
  });
}

const small = async (image, path, name) => {
  const answer = await fetch(
    `thumbnail?tab=${studio.tab}&path=${encodeURIComponent(path)}&of=${encodeURIComponent(name)}`);
  const about = at("about", path);
  image.hidden = !answer.ok;
  if (answer.ok) image.src = URL.createObjectURL(await answer.blob());
  if (about !== null && answer.ok) about.textContent = `${answer.headers.get("x-about")}; drop another image here`;
  image.onload = () => URL.revokeObjectURL(image.src);
};

// The scene of a link is the fragment of the page's address, which browsers do not send.
window.addEventListener("hashchange", () => {
  if (!location.hash.startsWith("#s=")) return;
  studio.send({ link: location.hash });
  history.replaceState(null, "", location.pathname + location.search);
});

// Small pictures follow the names of the textures.
const shown = new Map();
const look = () => {
  for (const image of all("[data-thumbnail]")) {
    const path = image.dataset.thumbnail, name = studio.values[path];
    if (name === undefined || shown.get(image) === name) continue;
    shown.set(image, name);
    if (name === null) { image.hidden = true; continue; }
    small(image, path, name);
  }
};
setInterval(look, 300);

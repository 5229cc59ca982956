// Images of the forms: chosen, dropped, sent to the server and shown small; and texts that are copied.

import { studio } from "./shared.js";

const tab = () => document.querySelector("#studio").dataset.tab;
const at = (name, path) => document.querySelector(`[data-${name}="${CSS.escape(path)}"]`);

const upload = async (path, file) => {
  const kind = file.name.split(".").pop().toLowerCase();
  const place = `texture?tab=${encodeURIComponent(tab())}&kind=${encodeURIComponent(kind)}`;
  try {
    const answer = await fetch(place, { method: "POST", body: file });
    const { name, error } = await answer.json();
    if (error) throw new Error(error);
    studio.put(path, name);
  } catch (error) {
    const fault = at("fault", path);
    if (fault !== null) [fault.textContent, fault.hidden] = [error.message, false];
  }
};

const copy = async (button) => {
  await navigator.clipboard.writeText(button.dataset.copy);
  const before = button.textContent;
  button.textContent = "Copied";
  setTimeout(() => { button.textContent = before; }, 1500);
};

document.addEventListener("click", (event) => {
  const browse = event.target.closest?.("[data-browse]");
  if (browse) at("upload", browse.dataset.browse)?.click();
  const button = event.target.closest?.("[data-copy]");
  if (button) copy(button);
});
document.addEventListener("change", (event) => {
  const { upload: path } = event.target.dataset ?? {};
  if (path && event.target.files.length) upload(path, event.target.files[0]);
});
for (const kind of ["dragover", "drop"]) {
  document.addEventListener(kind, (event) => {
    event.preventDefault(); // a file that misses the place must not replace the page
    const place = event.target.closest?.("[data-drop]");
    if (kind === "drop" && place && event.dataTransfer.files.length) {
      upload(place.dataset.drop, event.dataTransfer.files[0]);
    }
  });
}

const small = async (image, path, name) => {
  const answer = await fetch(
    `thumbnail?tab=${encodeURIComponent(tab())}&path=${encodeURIComponent(path)}&of=${encodeURIComponent(name)}`);
  const about = at("about", path);
  image.hidden = !answer.ok;
  if (answer.ok) image.src = URL.createObjectURL(await answer.blob());
  if (about !== null && answer.ok) about.textContent = `${answer.headers.get("x-about")}; drop another image here`;
  image.onload = () => URL.revokeObjectURL(image.src);
};

// The scene of a link is the fragment of the page's address, which browsers do not send.
const shared = async () => {
  if (!document.querySelector("#studio")?.dataset.tab) { setTimeout(shared, 50); return; }
  if (!location.hash.startsWith("#s=")) return;
  const answer = await fetch(`share?tab=${encodeURIComponent(tab())}`, { method: "POST", body: location.hash });
  const { error } = await answer.json();
  history.replaceState(null, "", location.pathname + location.search);
  const place = document.querySelector("#message");
  if (error && place !== null) [place.textContent, place.hidden] = [error, false];
};
shared();
window.addEventListener("hashchange", shared);

// Small pictures follow the names of the textures.
const shown = new Map();
const look = () => {
  for (const image of document.querySelectorAll("[data-thumbnail]")) {
    const path = image.dataset.thumbnail, name = studio.values[path];
    if (name === undefined || shown.get(image) === name) continue;
    shown.set(image, name);
    if (name === null) { image.hidden = true; continue; }
    small(image, path, name);
  }
};
setInterval(look, 300);

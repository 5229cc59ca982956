// Comparing what is shown with a pinned frame.
"use strict";

(() => {
  const one = (selector) => document.querySelector(selector);
  const studio = window.studio;

  let pinned = null, mode = "off", flipped = false;
  const copied = (source) => {
    const copy = document.createElement("canvas");
    [copy.width, copy.height] = [source.width, source.height];
    copy.getContext("2d").drawImage(source, 0, 0);
    return copy;
  };

  const pin = () => {
    if (studio.rung !== 2) return;
    pinned = copied(one("#canvas"));
    choose(mode === "off" ? "wipe" : mode);
  };

  studio.pinned = (image, columns, rows) => {
    pinned = document.createElement("canvas");
    [pinned.width, pinned.height] = [columns, rows];
    pinned.getContext("2d").drawImage(image, 0, 0);
    choose(mode === "off" ? "wipe" : mode);
  };

  const choose = (name) => {
    mode = pinned === null ? "off" : name;
    one("#compare").value = mode;
    compare();
  };

  const compare = () => {
    const over = one("#pinned"), canvas = one("#canvas");
    const fits = pinned !== null && pinned.width === canvas.width && pinned.height === canvas.height;
    over.hidden = !fits || (mode === "off" && !flipped) || (mode === "flip" && !flipped);
    one("#wipe").hidden = !fits || mode !== "wipe";
    one("#compare").disabled = pinned === null;
    if (over.hidden) return;
    if (over.width !== canvas.width) over.width = canvas.width;
    if (over.height !== canvas.height) over.height = canvas.height;
    const context = over.getContext("2d");
    context.drawImage(pinned, 0, 0);
    over.style.clipPath = "";
    if (mode === "wipe" && !flipped) over.style.clipPath = `inset(0 0 0 ${one("#wipe").value}%)`;
    if (mode !== "difference" || flipped) return;
    const size = [0, 0, canvas.width, canvas.height], now = canvas.getContext("2d").getImageData(...size);
    const then = context.getImageData(...size);
    for (let index = 0; index < now.data.length; index += 1) {
      then.data[index] = index % 4 === 3 ? 255 : 8 * Math.abs(now.data[index] - then.data[index]);
    }
    context.putImageData(then, 0, 0);
  };

  studio.compare = compare;
  studio.compares = (event) => { // a key
    if (event.key === "p" || event.key === "P") pin();
    if (event.key !== " " || event.target !== document.body || event.repeat) return;
    event.preventDefault();
    flipped = true;
    compare();
  };

  studio.beginComparing = () => {
    document.addEventListener("keyup", (event) => { if (event.key === " ") { flipped = false; compare(); } });
    one("#pin").addEventListener("click", pin);
    one("#compare").addEventListener("change", (event) => choose(event.target.value));
    one("#wipe").addEventListener("input", compare);
  };
})();

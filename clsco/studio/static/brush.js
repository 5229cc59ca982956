// The brush of inpainting: a mask is painted over an image, and goes to the server as runs.
"use strict";

(() => {
  const tab = () => document.querySelector("#studio").dataset.tab;
  const one = (name) => document.querySelector(`[data-brush="${name}"]`);
  const place = (what, rest = "") => `/inpainting/${what}?tab=${encodeURIComponent(tab())}${rest}`;
  let image = null, mask = new Uint8Array(0), tool = "brush", from = null, last = null;

  const say = (text) => { const told = one("told"); if (told !== null) told.textContent = text; };

  const draw = () => {
    const canvas = one("canvas"), context = canvas.getContext("2d");
    if (image === null) return;
    context.drawImage(image, 0, 0);
    const pixels = context.getImageData(0, 0, canvas.width, canvas.height), { data } = pixels;
    for (let k = 0; k < mask.length; k += 1) {
      if (!mask[k]) continue; // hatched, so that it is seen on any color
      const dark = (Math.floor(k % canvas.width) + Math.floor(k / canvas.width)) % 6 < 2;
      data[4 * k] = dark ? 120 : 255;
      data[4 * k + 1] = dark ? 0 : (data[4 * k + 1] * 0.35);
      data[4 * k + 2] = dark ? 40 : (data[4 * k + 2] * 0.35);
    }
    context.putImageData(pixels, 0, 0);
    const missing = mask.reduce((sum, value) => sum + value, 0);
    say(`${missing} of ${mask.length} pixels are missing`);
  };

  const taken = ({ columns, rows, runs, error }) => {
    if (error) { say(error); return; }
    mask = new Uint8Array(columns * rows);
    let at = 0;
    runs.forEach((run, k) => { if (k % 2) mask.fill(1, at, at + run); at += run; });
    draw();
  };

  const send = async (content) => {
    const answer = await fetch(place("mask"), { method: "POST", body: JSON.stringify(content) });
    const found = await answer.json();
    if (found.error) say(found.error);
    else if (content.runs === undefined) taken(found);
  };

  const runs = () => {
    const found = [];
    let value = 0, length = 0;
    for (const one of mask) {
      if (one === value) length += 1;
      else { found.push(length); value = one; length = 1; }
    }
    found.push(length);
    return found;
  };

  const load = async () => {
    const picture = new Image();
    picture.src = place("picture", `&which=image&at=${Date.now()}`);
    await picture.decode();
    image = picture;
    const canvas = one("canvas");
    [canvas.width, canvas.height] = [picture.naturalWidth, picture.naturalHeight];
    taken(await (await fetch(place("mask"))).json());
  };

  const position = (event) => {
    const canvas = one("canvas"), box = canvas.getBoundingClientRect();
    return [((event.clientX - box.left) * canvas.width) / box.width, ((event.clientY - box.top) * canvas.height) / box.height];
  };

  const stroke = (a, b) => { // a line as wide as the brush
    const canvas = one("canvas"), radius = Number(one("size").value) / 2, value = tool === "erase" ? 0 : 1;
    const [dx, dy] = [b[0] - a[0], b[1] - a[1]], long = dx * dx + dy * dy;
    const [left, right] = [Math.min(a[0], b[0]) - radius, Math.max(a[0], b[0]) + radius];
    const [top, bottom] = [Math.min(a[1], b[1]) - radius, Math.max(a[1], b[1]) + radius];
    for (let y = Math.max(0, Math.floor(top)); y <= Math.min(canvas.height - 1, bottom); y += 1) {
      for (let x = Math.max(0, Math.floor(left)); x <= Math.min(canvas.width - 1, right); x += 1) {
        const [px, py] = [x + 0.5 - a[0], y + 0.5 - a[1]];
        const along = long ? Math.min(1, Math.max(0, (px * dx + py * dy) / long)) : 0;
        if ((px - along * dx) ** 2 + (py - along * dy) ** 2 <= radius * radius) mask[y * canvas.width + x] = value;
      }
    }
  };

  const rectangle = (a, b) => {
    const canvas = one("canvas");
    const clip = (value, most) => Math.min(Math.max(Math.floor(value), 0), most);
    const [x0, x1] = [a[0], b[0]].map((x) => clip(x, canvas.width)).sort((p, q) => p - q);
    const [y0, y1] = [a[1], b[1]].map((y) => clip(y, canvas.height)).sort((p, q) => p - q);
    for (let y = y0; y < y1; y += 1) mask.fill(1, y * canvas.width + x0, y * canvas.width + x1);
  };

  const ended = () => {
    const canvas = one("canvas");
    send({ columns: canvas.width, rows: canvas.height, runs: runs() });
  };

  document.addEventListener("pointerdown", (event) => {
    if (event.target !== one("canvas") || image === null || event.button !== 0) return;
    from = last = position(event);
    event.target.setPointerCapture(event.pointerId);
    if (tool === "color") {
      send({ column: Math.floor(from[0]), row: Math.floor(from[1]), tolerance: Number(one("tolerance").value) / 100 });
      from = null;
    } else if (tool !== "rectangle") { stroke(from, from); draw(); }
  });
  document.addEventListener("pointermove", (event) => {
    if (from === null || tool === "rectangle") return;
    const now = position(event);
    stroke(last, now);
    last = now;
    requestAnimationFrame(draw);
  });
  document.addEventListener("pointerup", (event) => {
    if (from === null) return;
    if (tool === "rectangle") { rectangle(from, position(event)); draw(); }
    from = null;
    ended();
  });
  document.addEventListener("change", (event) => { if (event.target.dataset?.brush === "tool") tool = event.target.value; });
  document.addEventListener("click", (event) => {
    if (event.target.dataset?.brush !== "clear") return;
    mask.fill(0);
    draw();
    ended();
  });
  document.addEventListener("keydown", (event) => {
    if (!one("canvas")?.closest("dialog").open || !["[", "]"].includes(event.key)) return;
    const size = one("size");
    size.value = Number(size.value) * (event.key === "[" ? 0.8 : 1.25);
  });

  // The frame that is shown, as an image of the studio's folder; gives its name.
  const frame = async () => {
    const blob = await new Promise((done) => { document.querySelector("#canvas").toBlob(done, "image/png"); });
    const address = `/texture?tab=${encodeURIComponent(tab())}&kind=png`;
    return (await (await fetch(address, { method: "POST", body: blob })).json()).name ?? "";
  };

  window.studioBrush = { load, frame };
})();

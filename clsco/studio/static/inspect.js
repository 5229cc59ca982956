// What is known of the pixel under the cursor and comparing with a pinned frame.
"use strict";

(() => {
  const one = (selector) => document.querySelector(selector);
  const studio = window.studio;

  // ---- values under the cursor ------------------------------------------------------------------------------------
  let at = null, asked = false, again = false, drag = 1e6;
  const ask = () => {
    if (at === null) return;
    if (asked) { again = true; return; }
    asked = true;
    studio.send({ at });
  };

  const number = (value) => (value === null || value === undefined ? "∞" : Array.isArray(value) ? value.map(number).join(", ")
    : typeof value === "number" ? String(Number(value.toPrecision(6))) : String(value));

  const ROWS = [
    ["codes", "Codes", ""], ["color", "Light, linear", ""], ["sharp", "Light, all in focus", ""], ["depth", "Depth Z", "mm"],
    ["blur_radius", "Blur radius R", "px"], ["sigma", "Standard deviation σ", "px"], ["normal", "Normal", ""],
    ["flow", "Flow to the next frame", "px"], ["object", "Object", ""], ["object_id", "Object number", ""],
    ["missing", "Missing before filling", ""], ["hidden", "Hidden in the reference pose", ""],
    ["flow_occluded", "Hidden in the next frame", ""], ["uv", "Place in the texture", ""],
  ];

  studio.inspected = ({ values, psf, lens }) => {
    asked = false;
    one("#pixel").textContent = `x ${values.x}, y ${values.y}`;
    const table = one("#values");
    table.replaceChildren(...ROWS.filter(([name]) => name in values).map(([name, label, unit]) => {
      const row = document.createElement("tr"), head = document.createElement("th"), cell = document.createElement("td");
      head.textContent = label;
      head.scope = "row";
      cell.textContent = typeof values[name] === "boolean" ? (values[name] ? "yes" : "no") : `${number(values[name])}${unit && ` ${unit}`}`;
      row.append(head, cell);
      return row;
    }));
    spread(psf);
    diagram(lens);
    if (again) { again = false; ask(); }
  };
  studio.notInspected = () => { asked = false; };

  const spread = (psf) => {
    const plot = one("#psf"), context = plot.getContext("2d");
    one("#psf-part").hidden = psf === undefined;
    if (psf === undefined) return;
    const codes = Uint8Array.from(atob(psf.plot), (letter) => letter.charCodeAt(0));
    const data = new Uint8ClampedArray(4 * codes.length);
    codes.forEach((code, index) => data.set([code, code, code, 255], 4 * index));
    const side = Math.sqrt(codes.length), whole = new OffscreenCanvas(side, side);
    whole.getContext("2d").putImageData(new ImageData(data, side, side), 0, 0);
    const seen = Math.min(side, 2 * Math.ceil(1.3 * psf.reach + 2) + 1), edge = (side - seen) / 2;
    context.imageSmoothingEnabled = false;
    context.drawImage(whole, edge, edge, seen, seen, 0, 0, plot.width, plot.height);
    one("#psf-side").textContent = `${seen} × ${seen} px`;
    one("#psf-about").textContent = `|R| ${number(Math.abs(psf.radius))} px, sum ${number(psf.sum)}, centroid ${number(psf.centroid)} px, `
      + `RMS per axis ${number(psf.rms)} px (|R| / 2 = ${number(Math.abs(psf.radius) / 2)}), largest weight ${number(psf.largest)}`;
  };

  const diagram = (lens) => { // a schema: distances before the lens by their inverse, those behind it stretched
    const canvas = one("#lens"), context = canvas.getContext("2d"), { width, height } = canvas;
    const middle = height / 2 - 6, glass = 176, half = 30;
    const inverse = (distance) => (distance === null ? 0 : 1 / distance);
    const most = 1.5 * Math.max(inverse(lens.focus), inverse(lens.near), inverse(lens.depth), 1e-9);
    const before = (distance) => 8 + (glass - 30) * (inverse(distance) / most);
    context.clearRect(0, 0, width, height);
    context.font = "11px system-ui, sans-serif";
    context.textAlign = "center";
    context.fillStyle = "#2f4a35";
    context.fillRect(before(lens.far), middle - 34, before(lens.near) - before(lens.far), 68);
    const stroke = (color, ...points) => {
      context.strokeStyle = color;
      context.beginPath();
      points.forEach(([x, y], index) => (index ? context.lineTo(x, y) : context.moveTo(x, y)));
      context.stroke();
    };
    stroke("#777", [0, middle], [width, middle]);
    stroke("#7fd68a", [before(lens.focus), middle - 34], [before(lens.focus), middle + 34]);
    context.strokeStyle = "#6cb6ff";
    context.beginPath();
    context.ellipse(glass, middle, 6, half, 0, 0, 2 * Math.PI);
    context.stroke();
    const detector = glass + 64;
    stroke("#e9eaec", [detector, middle - 34], [detector, middle + 34]);
    if (lens.radius !== undefined) {
      const image = lens.image === null ? detector + 60
        : glass + 64 * Math.min(Math.max(1 + 12 * (lens.image / lens.sensor - 1), 0.25), 2);
      for (const side of [-1, 1]) {
        const far = detector + 40, rim = middle + side * half;
        stroke("#ffb457", [before(lens.depth), middle], [glass, rim], [far, rim + ((middle - rim) * (far - glass)) / (image - glass)]);
      }
      context.fillStyle = "#ffb457";
      context.beginPath();
      context.arc(before(lens.depth), middle, 3, 0, 2 * Math.PI);
      context.fill();
    }
    context.fillStyle = "#e9eaec";
    context.fillText("lens", glass, height - 4);
    context.fillText("detector", detector, height - 4);
    one("#lens-about").textContent = `In focus ${number(lens.focus)} mm; |R| below 0.5 px from ${number(lens.near)} to ${number(lens.far)} mm; `
      + `f ${number(lens.focal_length)}, D ${number(lens.aperture)}, s ${number(lens.sensor)} mm; point at ${number(lens.depth)} mm`;
  };

  const pointer = () => {
    const stage = one("#stage");
    stage.addEventListener("pointermove", (event) => {
      const found = studio.pixelAt(event.clientX, event.clientY);
      if (found === null || (at !== null && at[0] === found[0] && at[1] === found[1])) return;
      at = found;
      ask();
    });
    stage.addEventListener("click", (event) => {
      const found = studio.tool === "focus" ? studio.pixelAt(event.clientX, event.clientY) : null;
      if (found === null) return;
      drag += 1;
      studio.send({ focus: found, drag });
      studio.take("");
    });
  };
  studio.rested = () => { compare(); ask(); };

  // ---- comparing with a pinned frame ------------------------------------------------------------------------------
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

  studio.extra = (event) => {
    if (event.key === "f" || event.key === "F") return studio.take("focus");
    if (event.key === "m" || event.key === "M") return studio.take("move");
    if (event.key === "p" || event.key === "P") return pin();
    if (event.key === " " && event.target === document.body && !event.repeat) {
      event.preventDefault();
      flipped = true;
      compare();
    }
    return undefined;
  };

  studio.begin = () => {
    pointer();
    document.addEventListener("keyup", (event) => { if (event.key === " ") { flipped = false; compare(); } });
    one("#pin").addEventListener("click", pin);
    one("#compare").addEventListener("change", (event) => choose(event.target.value));
    one("#wipe").addEventListener("input", compare);
  };
})();

// The status: of what state the picture is that is shown, beside values that may be others already; and values at fault.

import { NO_NUMBER, RUNG } from "./protocol.js";
import { all, one, reword, sameKey, studio } from "./shared.js";

/** @type {import("./shared.js").Picture | null} */
let shown = null; // the picture that was painted last; null before, and while frames are played
const typed = new Map(); // the numbers of the latest changes, by path
let latest = -1, boxed = -1; // revisions of the scene, and of that whose values were told
let sent = 0, heard = 0; // changes that were sent, and that the studio has tried

const show = (text, kind) => {
  const badge = one("#badge");
  if (badge.textContent !== text) badge.textContent = text;
  badge.dataset.rung = kind;
};

const rung = (picture) => picture.rung === RUNG.EXACT && picture.revision > boxed ? RUNG.LOSSY : picture.rung;

const rendered = (picture) => {
  const { width, full, still } = picture;
  if (rung(picture) === RUNG.EXACT) return "Exact";
  if (rung(picture) === RUNG.LOSSY) return "Full size";
  return `Preview, ${Math.round((8 * width) / full[0])}/8 of the size${still ? ", no motion" : ""}`;
};

const earlier = ({ view, right, number, revision }) => { // in words, "" for what is of this state
  if (view !== studio.view) return `Earlier view: ${view}`;
  if (right !== studio.right) return "The other eye";
  if (number !== studio.index && (studio.moment === null || number !== NO_NUMBER)) return "Earlier frame";
  return revision < latest || heard < sent || Object.keys(studio.faults).length ? "Earlier values" : "";
};

studio.badge = (picture = shown) => {
  shown = picture;
  if (shown === null) return;
  const words = earlier(shown);
  show(words || rendered(shown), words ? "earlier" : rung(shown));
};

studio.played = () => {
  shown = null;
  show("Played", 0);
};

studio.changes = (path) => { // the number of the next change
  sent += 1;
  typed.set(path, sent);
  studio.badge();
  return sent;
};

/** A value that the studio tells is older than what is in the box. */
studio.isEcho = (path) => (typed.get(path) ?? 0) > heard;

studio.revised = (revision) => { // the scene has this revision; null: of a studio that was started again
  if (revision === null) { [latest, boxed, sent, heard] = [-1, -1, 0, 0]; typed.clear(); }
  else latest = Math.max(latest, revision);
};

studio.boxed = (revision) => { boxed = revision; }; // all values were told

studio.hearing.push((said) => {
  if (said.heard) heard = Math.max(heard, said.heard);
  studio.badge();
});

// ---- values at fault ----------------------------------------------------------------------------------------------
studio.mark = () => { // hardly any control is at fault: the others are not touched
  for (const control of all("[data-faulty]")) {
    if (control.dataset.path in studio.faults) continue;
    control.removeAttribute("data-faulty");
    control.removeAttribute("aria-invalid");
  }
  for (const place of all("[data-fault]:not([hidden])")) place.hidden = !(place.dataset.fault in studio.faults);
  const faults = Object.entries(studio.faults), [[first, rule] = ["", ""]] = faults;
  one("#wrong").hidden = !faults.length;
  reword(one("#fault"), `${first && `${first.replace(/\.(\d+)/g, "[$1]")}: `}${rule}${faults.length > 1 ? `; and ${faults.length - 1} more` : ""}`);
  for (const [path, fault] of faults) {
    for (const control of sameKey(path)) {
      control.setAttribute("data-faulty", "");
      control.setAttribute("aria-invalid", "true");
    }
    for (const place of all(`[data-fault="${CSS.escape(path)}"]`)) {
      reword(place, fault);
      place.hidden = false;
    }
  }
};

const reach = (path) => { // the control of a key, also in a panel that is closed, and of another object
  const find = () => sameKey(path).find((each) => each.type !== "range"), index = /^object\.(\d+)/.exec(path)?.[1];
  if (!find() && index) one(`.objects li:nth-child(${Number(index) + 1}) button`)?.click();
  setTimeout(() => {
    const control = find(), panel = control?.closest("details");
    if (panel) panel.open = true;
    if (panel && !control.checkVisibility({ visibilityProperty: true })) studio.dock("open", true);
    control?.focus();
  }, find() ? 0 : 400);
};
studio.parts.push(() => one("#to-fault").addEventListener("click", () => reach(Object.keys(studio.faults)[0] ?? "")));

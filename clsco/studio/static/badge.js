// The badge: of what state the picture is that is shown, beside values that may be others already.

import { NO_NUMBER, RUNG } from "./protocol.js";
import { one, studio } from "./shared.js";

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
  const { width, full, without } = picture;
  if (rung(picture) === RUNG.EXACT) return "exact of these values";
  if (rung(picture) === RUNG.LOSSY) return "full size";
  return `preview ${Math.round((8 * width) / full[0])}/8${without.map((part) => `, no ${part}`).join("")}`;
};

const earlier = ({ view, right, number, revision }) => { // in words, "" for what is of this state
  if (view !== studio.view) return `earlier view: ${view}`;
  if (right !== studio.right) return "of the other eye";
  if (number !== studio.index && (studio.moment === null || number !== NO_NUMBER)) return "earlier frame";
  const faults = Object.keys(studio.faults).length;
  if (faults) return `earlier values, ${faults} fault${faults === 1 ? "" : "s"}`;
  return revision < latest || heard < sent ? "earlier values" : "";
};

studio.badge = (picture = shown) => {
  shown = picture;
  if (shown === null) return;
  const words = earlier(shown);
  show(words || rendered(shown), words ? "earlier" : rung(shown));
};

studio.played = () => {
  shown = null;
  show("played", 0);
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

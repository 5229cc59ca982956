// For the case that the studio ends: the browser keeps the scene of a tab, and gives it to the next studio at its address.

import { all, on, one, studio } from "./shared.js";

const PREFIX = "clsco-tab-", MOST = 8, LONGEST = 60000; // scenes; characters of one, less than a message may have
const PAUSE = 200; // ms without a change
const CONTROLS = "#studio :is(button:not(#scene), input, select, textarea, summary), dialog :is(button, input, select, summary)";
/** @type {{ typed: Record<string, unknown> } | null} */
let kept = null; // the scene as the server told it
let underway = new Map(), timer = 0; // values that were sent before the server was asked for it
/** @type {[string, unknown][]} */
let given = []; // values that the page before this one had, and its scene has not

const read = (key) => {
  try { return JSON.parse(localStorage.getItem(key) ?? "null"); } catch { return null; }
};

const write = () => {
  if (kept === null) return;
  const text = JSON.stringify({ ...kept, typed: { ...kept.typed, ...Object.fromEntries(unknown()) }, at: Date.now() });
  if (text.length > LONGEST) return;
  try {
    localStorage.setItem(PREFIX + studio.tab, text);
    const keys = Object.keys(localStorage).filter((key) => key.startsWith(PREFIX));
    keys.sort((a, b) => (read(b)?.at ?? 0) - (read(a)?.at ?? 0));
    for (const key of keys.slice(MOST)) localStorage.removeItem(key);
  } catch { /* this browser keeps nothing; there still is what the studio keeps in its folder */ }
};

const unknown = () => [...underway, ...studio.sent];

const ask = () => {
  studio.flush();
  underway = new Map(unknown());
  studio.sent.clear();
  studio.send({ do: "keep" });
};

const say = (text) => {
  one("#lost").textContent = text;
  one("#lost").hidden = text === "";
};

studio.hearing.push((said) => {
  if (said.kept) {
    kept = said.kept;
    underway.clear();
    write();
  }
  if ("undo" in said) { // something is another
    clearTimeout(timer);
    timer = setTimeout(ask, PAUSE);
  }
  if (said.resumed) {
    for (const [path, value] of given) studio.set(path, value);
    given = [];
    say("The studio was started again. The scene is the one that this tab had; Undo leads to that of the start.");
    setTimeout(() => { if (studio.isOpen()) say(""); }, 10000);
  }
});

const still = (is) => { // without a server the page is read, and not worked
  for (const control of all(CONTROLS)) control.inert = is;
  for (const part of all("#lens-strip, #panels-scroll, #recipes, #views, #paint, #fills")) part.tabIndex = is ? 0 : -1; // to be scrolled by keys
};
on("keydown", (event) => {
  if (studio.tab && !studio.isOpen() && !event.key.includes("Tab")) event.stopImmediatePropagation();
}, { capture: true });

const visibility = () => studio.send({ hidden: document.hidden }); // what is in front is rendered first
on("visibilitychange", visibility);

studio.opened = () => {
  say("");
  visibility();
  still(false);
  const before = sessionStorage.getItem("tab");
  sessionStorage.setItem("tab", studio.tab);
  const old = before !== null && before !== studio.tab ? read(PREFIX + before) : null;
  if (old !== null) {
    given = Object.entries(old.typed ?? {});
    studio.send({ resume: old, tab: before });
  }
  for (const [path, value] of unknown()) studio.send({ path, value });
};

studio.closed = () => {
  say("The studio does not answer; it is tried again. This browser keeps the scene: start the studio again at the same "
    + "port, and open the address that it prints.");
  still(true);
  studio.flush();
  write();
};

// The frame of the page: its docks and sheets, light or dark, groups of buttons with one Tab stop, and commands by words.

import { all, made, on, one, studio } from "./shared.js";
import { summed } from "./views.js";

const NARROW = 900, DOCKED = 1600; // px, as in studio.css
const THEME = "clsco-theme";

// ---- docks and sheets ---------------------------------------------------------------------------------------------
const page = () => one("#studio").classList;
const SIDES = ["sided", "making"]; // the inspector and Generate, which share a column
const isIn = (name) => page().contains(name);
const shown = () => {
  one("#inspector").setAttribute("aria-pressed", String(isIn("sided")));
  one("#generate").setAttribute("aria-expanded", String(isIn("making")));
  const mode = one("#studio").dataset.mode === "inpaint" ? "inpaint" : "";
  const part = isIn("open") ? "open" : isIn("sided") ? "sided" : mode;
  for (const button of all("#tabs button")) button.setAttribute("aria-current", String(button.dataset.partOf === part));
};
studio.moded = () => { // the panels are of the other mode
  if (innerWidth < DOCKED) page().remove(...SIDES, "open");
  shown();
};

let wasSided = false; // before Generate was opened
/** Opens or closes the panels ("open"), the inspector ("sided") or Generate ("making"); in a narrow page one at a time. */
studio.dock = (name, on = !isIn(name === "open" && innerWidth > NARROW ? "folded" : name)) => {
  const isWide = innerWidth >= DOCKED;
  if (name === "making" && on) wasSided = isIn("sided");
  if (name === "open" && innerWidth > NARROW) {
    const covers = !isWide && SIDES.some(isIn);
    page().toggle("folded", on && !covers);
    if (covers) page().remove(...SIDES);
  } else {
    page().toggle(name, on);
    if (on) page().remove(...SIDES.filter((side) => side !== name && (name !== "open" || !isWide)), ...(isWide || name === "open" ? [] : ["open"]));
  }
  if (name === "making" && !on && isWide && wasSided) page().add("sided");
  if (name === "making") one(on ? "#making" : "#generate").focus();
  shown();
};

let most = Infinity; // jobs that were there; those of before the page do not open it
const jobs = () => { // one that has begun is brought into sight
  const rows = all("#making .job:is(.waiting, .running)");
  if (rows.length > most && !isIn("making")) studio.dock("making", true);
  if (rows.length > most) rows[0].scrollIntoView({ block: "nearest" });
  most = rows.length;
};

// ---- groups of buttons: arrows go from one to the next -------------------------------------------------------------
const GROUPS = "[role=toolbar], [role=tablist], #stops, #mode";
const members = (group) => [...group.querySelectorAll("button")].filter((each) => each.checkVisibility() && !each.disabled);
const rove = () => {
  for (const group of all(GROUPS)) {
    const buttons = members(group), stop = buttons.find((each) => each.matches("[aria-selected=true], [aria-checked=true]"))
      ?? buttons.find((each) => each.tabIndex === 0) ?? buttons[0];
    for (const each of group.querySelectorAll("button")) each.tabIndex = each === stop ? 0 : -1;
  }
};
on("focusin", (_, target) => {
  const group = target.closest?.(GROUPS);
  for (const each of group ? members(group) : []) each.tabIndex = each === target ? 0 : -1;
});
on("keydown", (event, target) => {
  const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key], group = target.closest?.(GROUPS);
  if (!step || !group) return;
  event.preventDefault();
  const buttons = members(group), next = buttons[(buttons.indexOf(target) + step + buttons.length) % buttons.length];
  next.focus();
  if (group.matches("#stops, #mode")) next.click();
});

// ---- commands by words ---------------------------------------------------------------------------------------------
const called = (button) => button.getAttribute("aria-label") ?? button.textContent.trim();
const COMMANDS = "#studio > header button, #views [role=tab], .panel > summary, .chip, #names button, #line button, #shown-panel button, .swatch";
const KEY = /(?:^|\()((?:(?:Ctrl|Shift) )*(?:[A-Z?[]|Enter))\)?$/; // at the end of a title
/** @typedef {{ label: string, act: () => void, icon?: Element | null, key?: string }} Command */
/** @type {(button: HTMLElement) => Command} */
const command = (button) => ({
  label: called(button), icon: button.querySelector("svg"), key: KEY.exec(button.title)?.[1],
  act: () => { button.focus(); button.click(); },
});
const value = (words) => { // a number after the words of a field: "f number 4"
  const number = Number(words.at(-1)), names = words.slice(0, -1);
  if (!names.length || !Number.isFinite(number)) return [];
  const fits = (box) => names.every((word) => `${box.getAttribute("aria-label")} ${box.dataset.path}`.toLowerCase().includes(word));
  return all('#studio input[type=text][data-kind][data-path]').filter(fits).slice(0, 4).map((box) =>
    ({ label: `${box.getAttribute("aria-label")}: ${number}`, act: () => studio.set(box.dataset.path, number) }));
};
/** @type {Command[]} */
let found = [];
let chosen = 0;
const search = () => {
  const words = one("#palette input").value.toLowerCase().replaceAll("-", " ").split(/\s+/).filter(Boolean);
  const isFound = (each) => words.every((word) => called(each).toLowerCase().includes(word));
  const buttons = all(COMMANDS).filter((each) => !each.disabled && !each.closest("dialog") && each.id !== "scene" && isFound(each));
  found = [...value(words), ...buttons.map(command)].slice(0, 12);
  mark(0);
};
const mark = (at) => {
  chosen = Math.min(Math.max(at, 0), Math.max(found.length - 1, 0));
  one("#found").replaceChildren(...found.map(({ label, icon, key }, k) => {
    const item = made("li", { id: `command-${k}`, onclick: () => run(k) }, icon?.cloneNode(true) ?? "", made("span", {}, label));
    if (key) item.append(made("kbd", {}, key));
    item.setAttribute("role", "option");
    item.setAttribute("aria-selected", String(k === chosen));
    return item;
  }));
  one("#palette input").setAttribute("aria-activedescendant", `command-${chosen}`);
};
const run = (at) => {
  one("#palette").close();
  found[at]?.act();
};
studio.find = () => {
  one("#palette input").value = "";
  search();
  one("#palette").showModal();
};

// ---- light or dark -------------------------------------------------------------------------------------------------
const theme = (name) => { document.documentElement.dataset.theme = name; };
const isDark = () => getComputedStyle(document.documentElement).colorScheme === "dark"
  || (!document.documentElement.dataset.theme && matchMedia("(prefers-color-scheme: dark)").matches);

studio.parts.push(() => {
  const known = localStorage.getItem(THEME);
  if (known) theme(known);
  one("#theme").addEventListener("click", () => {
    const name = isDark() ? "light" : "dark";
    theme(name);
    localStorage.setItem(THEME, name);
  });
  one("#find").addEventListener("click", studio.find);
  one("#palette input").addEventListener("input", search);
  one("#palette").addEventListener("keydown", (event) => {
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (step) { event.preventDefault(); mark(chosen + step); }
    if (event.key === "Enter") { event.preventDefault(); run(chosen); }
  });
  one("#more").addEventListener("click", () => {
    const isOpen = one("#views").toggleAttribute("data-all");
    one("#more").setAttribute("aria-expanded", String(isOpen));
    summed();
  });
  on("click", (_, target) => {
    const part = target.closest("[data-part-of]")?.dataset.partOf, to = target.closest("[data-to]")?.dataset.to;
    if (part === "" || part === "inpaint") studio.mode(part || "lens");
    if (part !== undefined) for (const name of ["open", ...SIDES]) if (name === part || isIn(name)) studio.dock(name, name === part);
    if (to) one(`#lens-strip input[type=text][data-path="${to}"]`).focus();
    for (const menu of all("#menu:popover-open")) if (target.closest("#menu button")) menu.hidePopover();
    setTimeout(rove);
  });
  new MutationObserver(jobs).observe(one("#recipes"), { childList: true, subtree: true });
  if (innerWidth >= DOCKED) studio.dock("sided", true);
  jobs();
  rove();
  shown();
});

// The frame of the page: its docks and sheets, light or dark, groups of buttons with one Tab stop, and commands by words.

import { all, made, on, one, studio } from "./shared.js";
import { summed } from "./views.js";

const NARROW = 900, DOCKED = 1600; // px, as in studio.css
const THEME = "clsco-theme";

// ---- docks and sheets ---------------------------------------------------------------------------------------------
const page = () => one("#studio").classList;
const shown = () => {
  one("#inspector").setAttribute("aria-pressed", String(page().contains("sided")));
  const part = page().contains("open") ? "open" : page().contains("sided") ? "sided" : "";
  for (const button of all("#tabs button")) button.toggleAttribute("aria-current", button.dataset.partOf === part);
};

/** Opens or closes the panels ("open") or the inspector with the jobs ("sided"); where the page is narrow, one at a time. */
studio.dock = (name, on = !page().contains(name === "open" && innerWidth > NARROW ? "folded" : name)) => {
  const other = name === "open" ? "sided" : "open";
  if (name === "open" && innerWidth > NARROW) {
    const sided = page().contains("sided") && innerWidth < DOCKED;
    page().toggle("folded", on && !sided);
    if (sided) page().remove("sided");
  } else {
    page().toggle(name, on);
    if (on && innerWidth < DOCKED) page().remove(other);
  }
  shown();
};

let most = 0; // jobs that were there
const jobs = () => { // one that has begun is brought into sight
  const count = all("#side .job:is(.waiting, .running)").length;
  if (count > most && !page().contains("sided")) studio.dock("sided", true);
  if (count > most) one("#side .job:is(.waiting, .running)").scrollIntoView({ block: "nearest" });
  most = count;
};

// ---- groups of buttons: arrows go from one to the next -------------------------------------------------------------
const GROUPS = "[role=toolbar], [role=tablist], #stops";
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
  if (group.id === "stops") next.click();
});

// ---- commands by words ---------------------------------------------------------------------------------------------
const called = (button) => button.getAttribute("aria-label") ?? button.textContent.trim();
const COMMANDS = "#studio > header button, #views [role=tab], .panel > summary, .chip, #names button, #line button, #shown-panel button, .swatch";
/** @type {(label: string, act: () => void) => [string, () => void]} */
const command = (label, act) => [label, act];
const value = (words) => { // a number after the words of a field: "f number 4"
  const number = Number(words.at(-1)), names = words.slice(0, -1);
  if (!names.length || !Number.isFinite(number)) return [];
  const fits = (box) => names.every((word) => `${box.getAttribute("aria-label")} ${box.dataset.path}`.toLowerCase().includes(word));
  return all('#studio input[type=text][data-kind][data-path]').filter(fits).slice(0, 4).map((box) =>
    command(`${box.getAttribute("aria-label")}: ${number}`, () => studio.set(box.dataset.path, number)));
};
/** @type {[string, () => void][]} */
let found = [];
let chosen = 0;
const search = () => {
  const words = one("#palette input").value.toLowerCase().replaceAll("-", " ").split(/\s+/).filter(Boolean);
  const buttons = all(COMMANDS).filter((each) => !each.disabled && words.every((word) => called(each).toLowerCase().includes(word)));
  found = [...value(words), ...buttons.map((each) => command(called(each), () => each.click()))].slice(0, 12);
  mark(0);
};
const mark = (at) => {
  chosen = Math.min(Math.max(at, 0), Math.max(found.length - 1, 0));
  one("#found").replaceChildren(...found.map(([label], k) => {
    const item = made("li", { id: `command-${k}`, onclick: () => run(k) }, label);
    item.setAttribute("role", "option");
    item.setAttribute("aria-selected", String(k === chosen));
    return item;
  }));
  one("#palette input").setAttribute("aria-activedescendant", `command-${chosen}`);
};
const run = (at) => {
  one("#palette").close();
  found[at]?.[1]();
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
    if (part === "inpaint") one("#inpaint").click();
    else if (part !== undefined) for (const name of ["open", "sided"]) studio.dock(name, name === part);
    if (to) one(`#lens-strip input[type=text][data-path="${to}"]`).focus();
    for (const menu of all("#menu:popover-open")) if (target.closest("#menu button")) menu.hidePopover();
    setTimeout(rove);
  });
  new MutationObserver(jobs).observe(one("#side"), { childList: true, subtree: true });
  if (innerWidth >= DOCKED) studio.dock("sided", true);
  jobs();
  rove();
  shown();
});

// Where the page is narrow, drawers hide parts of it: a job that has begun is brought into sight.

import { all, one, studio } from "./shared.js";

const NARROW = 1100; // px, as in studio.css
let most = -1; // jobs that were there; -1 before any were drawn

studio.parts.push(() => {
  new MutationObserver(() => {
    const count = all("#side .job").length;
    if (most >= 0 && count > most && innerWidth <= NARROW) {
      one("#studio").classList.remove("open");
      one("#studio").classList.add("sided");
      one("#side .job").scrollIntoView({ block: "center" });
    }
    most = count;
  }).observe(one("#side"), { childList: true, subtree: true });
});

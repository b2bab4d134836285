// The page that adds a robot: fetches itself again and again, and puts in place what changed of step 3.

import { PointerPause } from "../fleet/list.js";
import { freshPage, part, withoutTokens } from "../dom/page.js";

const EVERY_MS = 2000;
// Each fetch counts as a use of the login, and a page that nobody touches must not keep it.
const UNTOUCHED_MS = 15 * 60_000;
const OLD_MS = 10_000; // time without an answer after which the page says so
const EVENTS = ["pointerdown", "keydown", "focus"];

const elapsedMs = (at) => performance.now() - at;

class Arrivals {
  constructor(section) {
    this.section = section;
    this.touchedAt = this.shownAt = performance.now();
    this.pause = new PointerPause({ onEnd() {} }); // the next poll shows what came meanwhile
    this.pause.listen(part(section, "waiting"));
  }

  touch() {
    this.touchedAt = performance.now();
  }

  async poll() {
    if (document.hidden || this.chooses) return;
    const isUntouched = elapsedMs(this.touchedAt) > UNTOUCHED_MS;
    const page = isUntouched ? null : await freshPage(this.section.dataset.live);
    if (page && part(page, "arrivals")) this.show(page); // the page of a login that has ended has none
    part(this.section, "reload").hidden = elapsedMs(this.shownAt) < OLD_MS;
  }

  // Whether somebody is about to approve or reject: nothing may move, or a press meets another machine.
  get chooses() {
    return this.pause.active && part(this.section, "waiting").querySelector("button") !== null;
  }

  // Only what changed, and never under somebody's keyboard.
  show(page) {
    this.shownAt = performance.now();
    for (const name of ["arrivals", "waiting", "refused"]) {
      const [element, fresh] = [part(this.section, name), part(page, name)];
      if (element.contains(document.activeElement) || withoutTokens(element) === withoutTokens(fresh)) continue;
      element.replaceChildren(...fresh.childNodes);
    }
  }
}

const section = /** @type {HTMLElement} */ (document.querySelector("[data-live]"));
const arrivals = new Arrivals(section);
for (const name of EVENTS) window.addEventListener(name, () => arrivals.touch());
part(section, "reload").hidden = true; // while each poll has an answer
// Reloading the answer to the form would make another token.
if (location.pathname === "/admin/join-tokens") history.replaceState(null, "", section.dataset.live);
setInterval(() => arrivals.poll(), EVERY_MS);

// Lets a reload of the page go on driving. It is told when the page goes and believed once, soon after: a page that is
// opened, another tab of the same person, one that is duplicated or comes back later must not take the control by that.

import { LocalStore } from "../pages/localStore.js";

const GOOD_MS = 10_000;
const AGAIN = ["reload", "back_forward"];

export class ReloadStore {
  constructor(robot, { store = new LocalStore(() => globalThis.sessionStorage), arrival = arrived, now = () => Date.now() } = {}) {
    Object.assign(this, { store, arrival, now });
    this.name = `drove ${robot}`;
  }

  // `drove` as of driveMode.js, or null when the page did not drive.
  save(drove) {
    if (drove) this.store.write(this.name, { ...drove, at: this.now() });
  }

  // Gives it, or null.
  restore() {
    const drove = this.store.read(this.name);
    this.store.forget(this.name);
    if (!drove || !AGAIN.includes(this.arrival())) return null;
    return Math.abs(this.now() - drove.at) < GOOD_MS ? drove : null;
  }
}

// How the browser came to this page.
const arrived = () => performance.getEntriesByType("navigation")[0]?.type;

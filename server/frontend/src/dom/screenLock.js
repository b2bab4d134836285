// Keeps the screen on: to the system, a person at a gamepad, or one who waits for an offer, does not use the device.
export class ScreenLock {
  constructor({ page = document, request = async () => navigator.wakeLock?.request("screen") } = {}) {
    this.page = page;
    this.request = request;
    this.isWanted = false;
    /** @type {WakeLockSentinel | null | undefined} */
    this.lock = null;
    page.addEventListener("visibilitychange", () => this.renew()); // a hidden page loses it
  }

  keep(isWanted) {
    if (isWanted === this.isWanted) return;
    this.isWanted = isWanted;
    this.renew();
  }

  // A browser that has none, or refuses one, leaves it to the system.
  async renew() {
    this.lock?.release();
    this.lock = null;
    if (!this.isWanted || this.page.hidden) return;
    const lock = await this.request().catch(() => null);
    const isOurs = this.isWanted && !this.lock; // else a later request came first
    if (isOurs) this.lock = lock;
    else lock?.release();
  }
}

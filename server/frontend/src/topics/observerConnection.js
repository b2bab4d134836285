// A connection of its own that only watches, for probes of topics: a message that is too large for the server ends
// the connection it comes on, and that must not be the one that drives. Open only while a probe is open.

import { backoff } from "../client/api.js";

const TOO_BIG = 1009;

export class ObserverConnection {
  // `requestUrl()` gives a URL, `openLink(url, handlers)` a link as in rosbridge.js.
  constructor({ requestUrl, openLink }) {
    this.requestUrl = requestUrl;
    this.openLink = openLink;
    this.watchers = new Set();
    this.link = null;
    this.wanted = false;
    this.attempt = 0;
    this.delays = backoff();
  }

  // Whether there is a way to the robot: the page's own connection stands, and the page is seen.
  use(wanted) {
    if (wanted === this.wanted) return;
    this.wanted = wanted;
    this.delays = backoff();
    this.renew();
  }

  // `spec` as of rosbridge.js; `onState("lost"|"open"|"too_big")`. Gives the function that ends it.
  watch(spec, onMessage, onState = () => {}) {
    const watcher = { spec, onMessage, onState, channel: null };
    this.watchers.add(watcher);
    if (this.opened) this.attach(watcher);
    this.renew();
    return () => this.leave(watcher);
  }

  leave(watcher) {
    this.watchers.delete(watcher);
    watcher.channel?.end();
    watcher.channel = null;
    this.renew();
  }

  // Opens what is wanted and closes what is not.
  renew() {
    const wanted = this.wanted && this.watchers.size > 0;
    if (wanted && !this.attempting) this.open();
    if (!wanted && this.attempting) this.close();
  }

  async open() {
    const attempt = ++this.attempt;
    const current = (act) => (value) => attempt === this.attempt && act(value);
    this.attempting = true;
    const url = await this.requestUrl().catch(() => null);
    if (attempt !== this.attempt) return;
    if (url === null) return this.retry();
    this.link = this.openLink(url, {
      onOpen: current(() => this.begin()),
      onMessage: () => {},
      onOwn: () => {},
      onClose: current(({ code }) => this.lose(code)),
    });
  }

  begin() {
    this.opened = true;
    this.delays = backoff();
    for (const watcher of this.watchers) this.attach(watcher);
  }

  attach(watcher) {
    watcher.channel = this.link.subscribe(watcher.spec, watcher.onMessage);
    watcher.onState("open");
  }

  lose(code) {
    const watchers = [...this.watchers];
    this.drop();
    if (code === TOO_BIG) this.watchers.clear();
    for (const { onState } of watchers) onState(code === TOO_BIG ? "too_big" : "lost");
    if (this.watchers.size > 0) this.retry();
    else this.attempting = false;
  }

  retry() {
    this.attempting = true;
    this.timer = setTimeout(() => this.open(), this.delays.next().value);
  }

  close() {
    for (const { onState } of this.watchers) onState("lost");
    this.drop();
    this.attempting = false;
  }

  drop() {
    clearTimeout(this.timer);
    this.attempt += 1;
    this.opened = false;
    for (const watcher of this.watchers) watcher.channel = null;
    this.link?.close();
    this.link = null;
  }
}

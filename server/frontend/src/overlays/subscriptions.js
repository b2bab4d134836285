// What a reader of the robot's topics is subscribed to, by kind: the same topic again changes nothing, another one takes its place.

export class Subscriptions {
  // `subscribe(spec, handler)` as of connection.js.
  constructor(subscribe) {
    this.subscribe = subscribe;
    this.open = new Map();
  }

  // `topic` {name, type}, or nothing to end what there is; `limits` of the spec. Says whether another one was begun.
  follow(kind, topic, limits, handler) {
    const open = this.open.get(kind);
    if (open && open.name === topic?.name && open.type === topic?.type) return false;
    open?.end();
    this.open.delete(kind);
    if (!topic) return false;
    const { name, type } = topic;
    this.open.set(kind, { name, type, end: this.subscribe({ name, type, ...limits }, handler) });
    return true;
  }
}

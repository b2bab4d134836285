// What is known of a robot's control object (docs/protocols.md, "Control"). It comes twice: on the page's own
// connection and with the fleet's events. Mixing them would bring old news after new ones, so while the
// connection tells it, it alone counts. Pure.

export class ControlState {
  constructor({ onControl }) {
    this.onControl = onControl;
    this.linked = false;
    this.pending = null;
  }

  fromLink(control) {
    this.linked = true;
    this.pending = null;
    this.onControl(control);
  }

  fromFeed(control) {
    if (this.linked) this.pending = control;
    else this.onControl(control);
  }

  // What the events told since the connection's last word counts when that one has ended.
  linkEnded() {
    const { pending } = this;
    this.linked = false;
    this.pending = null;
    if (pending) this.onControl(pending);
  }
}

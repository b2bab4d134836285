// Looks at the gamepad once in each frame that the browser draws, while there is one; a page that nobody sees draws
// none. Browsers show a gamepad only after a button of it was pressed.

const PRESSED = 0.5; // for triggers, which some browsers never call pressed

export class GamepadLoop {
  // `onFound({id, mapping, axes, buttons})` comes with the device that is looked at from now on (axes, buttons: how
  // many), `onSeen({axes, buttons}, at)` with each look, `onLost()` when that device is gone, `onAll([{index, id, chosen}])`
  // with all that there are.
  constructor({ onFound, onSeen, onLost, onAll = () => {}, ...options }) {
    const { pads, frame, now } = { ...BROWSER, ...options };
    Object.assign(this, { onFound, onSeen, onLost, onAll, pads, frame, now });
    this.chosen = null; // {index, id}
    this.waiting = false;
  }

  listen(target) {
    for (const name of ["gamepadconnected", "gamepaddisconnected"]) {
      target.addEventListener(name, () => this.recount());
    }
    this.recount();
  }

  // Another device; what the last one held is lost.
  choose(index) {
    this.lose();
    const pad = this.connected().find((one) => one.index === index);
    if (pad) this.find(pad);
    this.recount();
  }

  recount() {
    const all = this.connected();
    this.onAll(all.map(({ index, id }) => ({ index, id, chosen: index === this.chosen?.index })));
    if (all.length > 0) this.wait();
    else this.lose(); // also while no frame is drawn
  }

  wait() {
    if (this.waiting) return;
    this.waiting = true;
    this.frame(() => this.poll());
  }

  poll() {
    this.waiting = false;
    const at = this.now();
    const all = this.connected();
    const pad = all.find(({ index, id }) => index === this.chosen?.index && id === this.chosen.id);
    if (pad) this.onSeen(sampled(pad), at);
    else this.change(all[0]);
    if (all.length > 0) this.wait();
  }

  change(pad) {
    this.lose();
    if (pad) this.find(pad);
    this.recount();
  }

  find({ index, id, mapping, axes, buttons }) {
    this.chosen = { index, id };
    this.onFound({ id, mapping, axes: axes.length, buttons: buttons.length });
  }

  lose() {
    if (!this.chosen) return;
    this.chosen = null;
    this.onLost();
  }

  connected() {
    return [...this.pads()].filter((pad) => pad?.connected);
  }
}

const sampled = ({ axes, buttons }) => ({
  axes: [...axes],
  buttons: buttons.map(({ pressed, value }) => pressed || value > PRESSED),
});

// A page inside another one may not be let look.
function browserPads() {
  try {
    return navigator.getGamepads?.() ?? [];
  } catch {
    return [];
  }
}

const BROWSER = {
  pads: browserPads,
  frame: (act) => requestAnimationFrame(act),
  now: () => performance.now(),
};

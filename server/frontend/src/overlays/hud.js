// Commanded and measured speed as a figure over the video: an arrow for the way (up is forward), an arc for the turn
// (to the left is left). Hollow is what was commanded, filled what the robot measures.

const SIZE = 96; // CSS pixels, as in drive-view.css
const RADIUS = 34;
const WANTED = "#ffd166";
const MEASURED = "#ffffff";
const BACK = "rgb(10 13 17 / 60%)";
const STILL = 0.005;

export class Hud {
  // `scale` {speed, turn}: what reaches the edge, in m/s and rad/s.
  constructor(canvas, { scale }) {
    this.canvas = canvas;
    this.scale = scale;
    this.context = canvas.getContext("2d");
    this.twists = { wanted: null, measured: null };
    this.shown = true;
  }

  show(shown) {
    this.shown = shown;
    this.canvas.hidden = !shown;
    this.draw();
  }

  // `twist` {forward, left, turn}, null for unknown.
  wanted(twist) {
    this.twists.wanted = twist;
    this.draw();
  }

  measured(twist) {
    this.twists.measured = twist;
    this.draw();
  }

  draw() {
    if (!this.shown) return;
    this.frame ??= requestAnimationFrame(() => {
      this.frame = undefined;
      this.paint();
    });
  }

  paint() {
    const { canvas, context } = this;
    const ratio = window.devicePixelRatio || 1;
    canvas.width = canvas.height = SIZE * ratio;
    context.setTransform(ratio, 0, 0, ratio, (SIZE * ratio) / 2, (SIZE * ratio) / 2);
    disc(context);
    const { wanted, measured } = this.twists;
    if (measured) this.twist(measured, { colour: MEASURED, width: 6 });
    if (wanted) this.twist(wanted, { colour: WANTED, width: 2 });
  }

  twist({ forward, left = 0, turn }, pen) {
    const [up, aside] = [part(forward, this.scale.speed), part(left, this.scale.speed)];
    if (Math.hypot(up, aside) > STILL) arrow(this.context, -aside * RADIUS, -up * RADIUS, pen);
    const sweep = part(turn, this.scale.turn);
    if (Math.abs(sweep) > STILL) arc(this.context, sweep, pen);
  }
}

// Of the greatest, -1 to 1.
const part = (value, most) => Math.max(-1, Math.min(1, (value || 0) / most));

function disc(context) {
  context.fillStyle = BACK;
  context.beginPath();
  context.arc(0, 0, SIZE / 2, 0, 2 * Math.PI);
  context.fill();
}

function arrow(context, x, y, { colour, width }) {
  context.beginPath();
  context.moveTo(0, 0);
  context.lineTo(x, y);
  stroke(context, colour, width);
  context.beginPath();
  context.arc(x, y, width / 2 + 3, 0, 2 * Math.PI);
  stroke(context, colour, Math.min(width, 3));
}

// From straight ahead, a quarter of the circle at the most.
function arc(context, sweep, { colour, width }) {
  const ahead = -Math.PI / 2;
  context.beginPath();
  context.arc(0, 0, RADIUS + 8, ahead, ahead - (sweep * Math.PI) / 2, sweep > 0);
  stroke(context, colour, width);
}

function stroke(context, colour, width) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.lineCap = "round";
  context.stroke();
}

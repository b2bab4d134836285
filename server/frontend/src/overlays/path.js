// The way that the robot came by its odometry, of bounded length. Pure.

const MOST = 2000;
const STEP_M = 0.05;
const JUMP_M = 5;

export class Path {
  constructor() {
    this.points = [];
    this.step = STEP_M;
  }

  // Says whether the path has grown. A jump is a new beginning of the odometry and no way.
  add({ x, y }) {
    if (!Number.isFinite(x) || !Number.isFinite(y)) return false;
    const last = this.points.at(-1);
    const way = last ? Math.hypot(x - last.x, y - last.y) : Infinity;
    if (last && way > JUMP_M) this.clear();
    else if (way < this.step) return false;
    this.points.push({ x, y });
    if (this.points.length > MOST) this.thin();
    return true;
  }

  // The whole way stays, in longer steps.
  thin() {
    this.points = this.points.filter((_, i) => i % 2 === 0);
    this.step *= 2;
  }

  clear() {
    this.points = [];
    this.step = STEP_M;
  }
}

// Mixes all inputs to a twist that this kind of robot can follow, within the limits. Pure.

export const STILL = { forward: 0, left: 0, turn: 0 };

// `inputs` are {forward, left, turn} from -1 to 1, forward and left positive, `turbo` true for the higher limits.
// `limits` are {linear, angular} in m/s and rad/s, with `turbo` of the same shape, and `most`: the robot's own.
export function mixed(inputs, limits, kind) {
  const { linear, angular } = inputs.some(({ turbo }) => turbo) ? (limits.turbo ?? limits) : limits;
  const [forward, left, turn] = ["forward", "left", "turn"].map((name) => total(inputs, name));
  if (kind === "holonomic") return { ...together(forward, left, linear), turn: turn * angular };
  if (kind === "ackermann") return steered(forward * linear, turn * angular, limits.most?.linear ?? linear);
  return { forward: forward * linear, left: 0, turn: turn * angular };
}

const total = (inputs, name) => clamp(inputs.reduce((sum, input) => sum + (input[name] ?? 0), 0));

const clamp = (value) => Math.min(1, Math.max(-1, value)) + 0; // + 0 turns -0 into 0

// The limit is that of the speed, whichever way it goes.
function together(forward, left, linear) {
  const scale = linear / Math.max(1, Math.hypot(forward, left));
  return { forward: forward * scale, left: left * scale };
}

// A car turns as it goes, the other way when it backs: the stick says how far the wheels are turned, and
// `turn` is what that makes at the robot's highest speed.
const steered = (forward, turn, highest) => ({ forward, left: 0, turn: (turn * forward) / highest + 0 });

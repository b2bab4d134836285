// Where the time of a round trip goes. Pure.

// `total` from this page to the robot's rosbridge and back, `server` to the server, `robot` from there to the robot: ms,
// or null for what is not known. They are measured apart, so what is left for rosbridge is never told as less than 0.
export function latencyBreakdown({ total, server, robot }) {
  const known = [total, server, robot].every((part) => Number.isFinite(part));
  return { server, robot, rosbridge: known ? Math.max(0, total - server - robot) : null };
}

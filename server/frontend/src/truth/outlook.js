// The one state that the page's banner shows, out of all that is true at once: what keeps the robot from driving
// comes first. Pure.

export const NAMES = ["stopping", "stopped", "guard_down", "held", "blind"];

// `state` is the connection's (states.js); `control` as in docs/protocols.md, `sight` the kind of sighthold.js.
export function outlook({ name }, { control = {}, driving, sight }) {
  if (name !== "live") return name;
  return robots(control) ?? (driving ? pictures(sight) : null) ?? "live";
}

function robots({ stopped, guard }) {
  if (stopped) return stopped.confirmed ? "stopped" : "stopping";
  return guard === "down" ? "guard_down" : null;
}

// Whoever watches is held by nothing.
function pictures(sight) {
  if (sight === "missing" || sight === "old") return "held";
  return sight === "blind" ? "blind" : null;
}

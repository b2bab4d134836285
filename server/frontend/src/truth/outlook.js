// The one state that the page's banner shows, out of all that is true at once: what keeps the robot from driving
// comes first. Pure.

const AWAY = ["offline", "link_lost"]; // what a robot is that was disabled

// `state` is the connection's (states.js); `control` as in docs/protocols.md, `sight` the kind of sighthold.js; `disabled` by an
// administrator.
export function outlook({ name }, { control = {}, driving, sight, disabled = false }) {
  if (name !== "live") return disabled ? asDisabled(name) : name;
  return robots(control) ?? (driving ? pictures(sight) : null) ?? "live";
}

const asDisabled = (name) => (AWAY.includes(name) ? "disabled" : name);

function robots({ stopped, guard }) {
  if (stopped) return stopped.confirmed ? "stopped" : "stopping";
  return guard === "down" ? "guard_down" : null;
}

// Whoever watches is held by nothing.
function pictures(sight) {
  if (sight === "missing" || sight === "old") return "held";
  return sight === "blind" ? "blind" : null;
}

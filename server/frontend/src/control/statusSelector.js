// The one state that the page's banner shows, out of all that is true at once: what keeps the robot from driving
// comes first. Pure.

const AWAY = ["offline", "link_lost"]; // what a robot is that was disabled

// `state` is the connection's (states.js); `control` as in docs/protocols.md, `video` the kind of videoInterlock.js; `disabled` by an
// administrator.
export function selectStatus({ name }, { control = {}, driving, video, disabled = false }) {
  if (name !== "live") return disabled ? asDisabled(name) : name;
  return robotStatus(control) ?? (driving ? videoStatus(video) : null) ?? "live";
}

const asDisabled = (name) => (AWAY.includes(name) ? "disabled" : name);

function robotStatus({ stopped, guard }) {
  if (stopped) return stopped.confirmed ? "stopped" : "stopping";
  return guard === "down" ? "guard_down" : null;
}

// Whoever watches is held by nothing.
function videoStatus(video) {
  if (video === "missing" || video === "old") return "held";
  return video === "blind" ? "blind" : null;
}

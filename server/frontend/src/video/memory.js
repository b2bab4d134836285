// What the person chose for the picture of a robot, on this device. A browser that keeps nothing is no error.

const key = (robot) => `robotether.sight.${robot}`;

export function recall(robot, storage = globalThis.localStorage) {
  try {
    const kept = JSON.parse(storage.getItem(key(robot)));
    return kept !== null && typeof kept === "object" ? kept : {};
  } catch {
    return {};
  }
}

export function remember(robot, value, storage = globalThis.localStorage) {
  try {
    storage.setItem(key(robot), JSON.stringify(value));
  } catch {
    // Full, or forbidden in a private window: then it is as it was on the next visit.
  }
}

// How old the driver's video is, never less than the truth. Driving pauses by it. Pure.

const REPORT_MS = 100;
const SLEPT_MS = 500; // more than clocks drift between two looks

// `offered`: the robot has a camera at all. `at`: the timestamp of the main frame, null for none.
// Gives {state: "fresh"|"old"|"none"|"off", ageMs}.
export function freshness({ offered, hidden, at }, limitMs, now) {
  if (!offered || hidden) return { state: "off", ageMs: null };
  if (at === null) return { state: "none", ageMs: null };
  const ageMs = Math.max(0, now - at);
  return { state: ageMs > limitMs ? "old" : "fresh", ageMs };
}

// Hands readings on at each change of state, and else ten times a second at most.
export class FreshnessReporter {
  constructor(report) {
    this.report = report;
    this.state = null;
    this.reportedAt = -Infinity;
  }

  receive(reading, now) {
    if (reading.state === this.state && now - this.reportedAt < REPORT_MS) return;
    this.state = reading.state;
    this.reportedAt = now;
    this.report(reading);
  }
}

// The timestamp of what is in the main place. Another camera that is put there begins with the timestamp of the one before, as the
// driver has seen that much; from its own first frame on it answers for itself.
export class MainTimestamp {
  constructor() {
    this.id = null;
    this.before = null;
  }

  // `at` is the timestamp of the newest frame of the source `id`, null before its first.
  read(id, at) {
    if (id !== this.id) {
      this.before = this.newest ?? null;
      this.id = id;
    }
    this.newest = at ?? this.before;
    return this.newest;
  }
}

// performance.now() may stand still while the machine sleeps, and what was seen before would look new after it.
export class Sleep {
  constructor() {
    this.apart = Infinity;
  }

  // Says whether the machine slept since the last look; `wall` is the time of day, which goes on.
  isOver(now, wall) {
    const apart = wall - now;
    const slept = apart - this.apart > SLEPT_MS;
    this.apart = apart;
    return slept;
  }
}

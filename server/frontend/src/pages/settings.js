// What the drive page takes from a robot's settings (docs/reference/robot-settings.md). Pure.

const USUAL = { topic: "/cmd_vel", linear: 1.0, angular: 1.5, holdAfterMs: 1000, maxAgeMs: 500 };

// Gives {driveTopic, driveType, kind, wheelbase, limits: {maxLinear, maxAngular}, holdAfterMs, oldMs, maxAgeMs, isLimitedByAge}, in m,
// m/s, rad/s and ms; the limits are never more than the robot's guard allows. `driveTopic` "": the guard has patterns alone, and no
// name that the page knows fits. `holdAfterMs` null: old video does not pause driving; it is shown to be old after `oldMs`.
// `driveType` null: it follows the robot. The guard drops commands that are older than `maxAgeMs`. `isLimitedByAge`: the robot
// drives slower when the driver sees late.
/** @param {{guard?: Record<string, any>, page?: Record<string, any>}} settings */
export function driveSettings({ guard = {}, page = {} }) {
  const { kind = "differential", wheelbase_m: wheelbase = null } = page;
  const { drive_type: driveType = null } = page;
  const { max_age_ms: maxAgeMs = USUAL.maxAgeMs } = guard;
  const isLimitedByAge = [guard.blind_m, guard.blind_deg].some(Number.isFinite);
  const times = { ...videoTimes(page), maxAgeMs, isLimitedByAge };
  return { driveTopic: topic(page, guard), driveType, kind, wheelbase, limits: limits(page, guard), ...times };
}

const videoTimes = ({ hold_after_ms: holdAfterMs = USUAL.holdAfterMs }) => ({ holdAfterMs, oldMs: holdAfterMs ?? USUAL.holdAfterMs });

// Another topic is none of a drive: no guard would watch it.
function topic({ drive_topic = "" }, { drive_topics = [USUAL.topic] }) {
  return drive_topic || drive_topics.find((glob) => !glob.includes("*")) || (drive_topics.some(fitsUsual) ? USUAL.topic : "");
}

const fitsUsual = (glob) => new RegExp(`^${glob.replaceAll("*", ".*")}$`).test(USUAL.topic);

const limits = (page, guard) => ({
  maxLinear: limit(page.max_speed_m_s, guard.max_speed_m_s, USUAL.linear),
  maxAngular: limit(page.max_turn_rad_s, guard.max_turn_rad_s, USUAL.angular),
});

const limit = (own, guards, usual) => Math.min(own ?? guards ?? usual, guards ?? Infinity);

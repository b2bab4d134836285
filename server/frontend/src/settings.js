// What the drive page takes from a robot's settings. Pure.

const USUAL = { topic: "/cmd_vel", linear: 1.0, angular: 1.5 };

// Gives {driveTopic, maxLinear, maxAngular} in m/s and rad/s: never more than the robot's guard lets through.
export function driveSettings({ guard = {}, drive_topic, max_linear, max_angular }) {
  const named = guard.drive_topics?.find((topic) => !topic.includes("*"));
  return {
    driveTopic: drive_topic || named || USUAL.topic,
    maxLinear: limit(max_linear, guard.max_speed_m_s, USUAL.linear),
    maxAngular: limit(max_angular, guard.max_turn_rad_s, USUAL.angular),
  };
}

const limit = (own, guards, usual) => Math.min(own ?? guards ?? usual, guards ?? Infinity);

// Names and shapes of the ROS messages that the drive page uses, under their ROS 1 and ROS 2 names. Pure.

const TWIST = "geometry_msgs/Twist";
const TWIST_STAMPED = "geometry_msgs/TwistStamped";

// "geometry_msgs/msg/Twist" (ROS 2) and "geometry_msgs/Twist" (ROS 1) are one type.
export const plainType = (type) => type.replace("/msg/", "/");

// The type to advertise cmd_vel with. rosbridge of either ROS takes the ROS 1 name, of ROS 2 both;
// what the robot says itself comes first, for bridges that are stricter.
export function twistType(topicType, typesSeen) {
  if (isTwist(topicType)) return topicType;
  return typesSeen.some((type) => type.includes("/msg/")) ? "geometry_msgs/msg/Twist" : TWIST;
}

const isTwist = (type) => [TWIST, TWIST_STAMPED].includes(plainType(type || ""));

// `forward` in m/s, `turn` in rad/s, left positive (REP-103).
export function twistMessage(type, { forward, turn }) {
  const twist = { linear: { x: forward, y: 0, z: 0 }, angular: { x: 0, y: 0, z: turn } };
  return plainType(type) === TWIST_STAMPED ? { header: { frame_id: "" }, twist } : twist;
}

const SPEED_READERS = {
  "nav_msgs/Odometry": ({ twist }) => ({
    forward: twist.twist.linear.x,
    turn: twist.twist.angular.z,
  }),
  "turtlesim/Pose": ({ linear_velocity, angular_velocity }) => ({
    forward: linear_velocity,
    turn: angular_velocity,
  }),
};

// The function that reads {forward, turn} out of a message of this type, or undefined.
export const speedReader = (type) => SPEED_READERS[plainType(type)];

const SPEED_TYPES = Object.keys(SPEED_READERS);
const SPEED_TOPICS = ["/odom", "/pose"];

// The topic that tells the robot's speed: odometry before pose, the usual name before others.
export function speedTopic(topics) {
  const rank = ({ name, type }) =>
    SPEED_TYPES.indexOf(plainType(type)) * 2 + (SPEED_TOPICS.includes(name) ? 0 : 1);
  return topics.filter(({ type }) => speedReader(type)).sort((a, b) => rank(a) - rank(b))[0];
}

export const imageTopics = (topics) =>
  topics
    .filter(({ type }) => plainType(type) === "sensor_msgs/Image")
    .map(({ name }) => name)
    .sort();

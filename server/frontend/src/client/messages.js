// Names and shapes of the ROS messages that the drive page uses, under their ROS 1 and ROS 2 names. Pure.

const TWIST = "geometry_msgs/Twist";
const TWIST_STAMPED = "geometry_msgs/TwistStamped";
const ACKERMANN_STAMPED = "ackermann_msgs/AckermannDriveStamped";
const DRIVE_TYPES = [TWIST, TWIST_STAMPED, ACKERMANN_STAMPED];

// Of a robot whose settings do not tell: about that of the small cars that take steering angles.
const USUAL_WHEELBASE_M = 0.33;

// "geometry_msgs/msg/Twist" (ROS 2) and "geometry_msgs/Twist" (ROS 1) are one type.
export const plainType = (type) => type.replace("/msg/", "/");

// Whether the robot takes speed and steering angle: only a car does.
export const isSteered = (type) => plainType(type ?? "") === ACKERMANN_STAMPED;

// The type to advertise the drive topic with. rosbridge of either ROS takes the ROS 1 name, of ROS 2 both;
// what the robot says itself comes first, for bridges that are stricter.
export function twistType(topicType, typesSeen) {
  if (DRIVE_TYPES.includes(plainType(topicType || ""))) return topicType;
  return typesSeen.some((type) => type.includes("/msg/")) ? "geometry_msgs/msg/Twist" : TWIST;
}

// `forward` and `left` in m/s, `turn` in rad/s, left positive (REP-103); `wheelbase` in m.
export function driveMessage(type, { forward, left = 0, turn }, { wheelbase } = {}) {
  const plain = plainType(type);
  if (plain === ACKERMANN_STAMPED) return carMessage(forward, turn, wheelbase);
  const twist = { linear: { x: forward, y: left, z: 0 }, angular: { x: 0, y: 0, z: turn } };
  return plain === TWIST_STAMPED ? { header: { frame_id: "" }, twist } : twist;
}

// The angle at which the wheels follow the twist's curve. Standing still has no curve: then they point ahead.
function carMessage(speed, turn, wheelbase) {
  const curvature = speed === 0 ? 0 : turn / speed;
  const steering_angle = Math.atan(curvature * (wheelbase ?? USUAL_WHEELBASE_M));
  return { header: { frame_id: "" }, drive: { steering_angle, speed } };
}

const SPEED_READERS = {
  "nav_msgs/Odometry": ({ twist }) => ({
    forward: twist.twist.linear.x,
    left: twist.twist.linear.y ?? 0,
    turn: twist.twist.angular.z,
  }),
  "turtlesim/Pose": ({ linear_velocity, angular_velocity }) => ({
    forward: linear_velocity,
    left: 0,
    turn: angular_velocity,
  }),
};

// The function that reads {forward, left, turn} out of a message of this type, or undefined.
export const speedReader = (type) => SPEED_READERS[plainType(type)];

const SPEED_TYPES = Object.keys(SPEED_READERS);
const SPEED_TOPICS = ["/odom", "/pose"];

// The topic that tells the robot's speed: odometry before pose, the usual name before others.
export function speedTopic(topics) {
  const rank = ({ name, type }) => SPEED_TYPES.indexOf(plainType(type)) * 2 + (SPEED_TOPICS.includes(name) ? 0 : 1);
  return topics.filter(({ type }) => speedReader(type)).sort((a, b) => rank(a) - rank(b))[0];
}

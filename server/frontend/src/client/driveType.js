// Finds the type of message that the drive topic takes: as the robot reports it, else as it is set, else by its ROS.

import { isDriveType } from "./rosbridge.js";

export class DriveTypeQuery {
  // `set` is the type that the robot's settings name, or null.
  /** @param {{topic: string, set?: string | null}} options */
  constructor({ topic, set = null }) {
    this.topic = topic;
    this.set = set;
    this.reported = "";
    this.ros = /** @type {{version?: number, distro?: string}} */ ({});
  }

  // What the robot reported once holds while it reports nothing: another type in mid-drive would stop it.
  // Both are asked at once: a rosapi that hangs must not take twice its time (connection.js).
  async find(call) {
    const [{ type }] = await Promise.all([ask(call, "/rosapi/topic_type", { topic: this.topic }), this.findRos(call)]);
    if (typeof type === "string" && isDriveType(type)) this.reported = type;
    return this.reported || this.set || usualType(this.ros);
  }

  async findRos(call) {
    if (this.reported || this.set || this.ros.version) return;
    this.ros = await ask(call, "/rosapi/get_ros_version", {});
  }
}

// A robot without rosapi is no error: the page then goes by the usual names.
export async function ask(call, service, request) {
  const { ok, values } = await call(service, request);
  return (ok && values) || {};
}

// ROS 2 names its releases by the alphabet. From Jazzy on, Nav2 and ros2_control take stamped commands.
const FIRST_STAMPED = "jazzy";

// Of rosapi's GetROSVersion. Without an answer it is the ROS 1 name, which rosbridge of either ROS takes.
export function usualType({ version = 0, distro = "" }) {
  if (version !== 2) return "geometry_msgs/Twist";
  return distro >= FIRST_STAMPED ? "geometry_msgs/msg/TwistStamped" : "geometry_msgs/msg/Twist";
}

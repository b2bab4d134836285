// Poses in the plane, {x, y, theta} in m and rad (REP-103), and the messages that tell them. Pure.

import { plainType } from "../client/messages.js";
import { planar } from "./grid.js";

const READERS = {
  "nav_msgs/Odometry": ({ pose }) => planar(pose.pose),
  "geometry_msgs/PoseWithCovarianceStamped": ({ pose }) => planar(pose.pose),
  "turtlesim/Pose": ({ x, y, theta }) => ({ x, y, theta }),
};

// The function that reads a pose out of a message of this type, or undefined.
export const poseReader = (type) => READERS[plainType(type)];

// Where `pose`, which is told in the frame of `frame`, is in the frame that `frame` is told in.
export function compose(frame, { x, y, theta }) {
  const [cos, sin] = [Math.cos(frame.theta), Math.sin(frame.theta)];
  return {
    x: frame.x + x * cos - y * sin,
    y: frame.y + x * sin + y * cos,
    theta: frame.theta + theta,
  };
}

export function inverse({ x, y, theta }) {
  const [cos, sin] = [Math.cos(theta), Math.sin(theta)];
  return { x: -x * cos - y * sin, y: x * sin - y * cos, theta: -theta };
}

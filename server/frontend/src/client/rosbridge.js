// What goes over rosbridge: a link by roslib, and the ROS messages on it.

import { Ros, Topic } from "roslib";

/**
 * @typedef {{
 *   onOpen: () => void,
 *   onMessage: (message: object) => void,
 *   onOwn: (operation: any) => void,
 *   onClose: (event: CloseEvent) => void,
 * }} LinkHandlers
 * @typedef {{name: string, type?: string, throttleMs?: number, queueLength?: number, onRefused?: (why: string) => void}} TopicSpec
 */

// One roslib connection, from its opening to its end; connection.js opens the next one.
// A fresh Ros a link: roslib would otherwise queue what is sent while it is cut, and replay old
// drive commands to the robot when the link returns.
/** @type {(url: string, handlers: LinkHandlers) => Link} */
export function openLink(url, handlers) {
  return new Link(url, handlers);
}

export class Link {
  // `onMessage` gets what the robot says, `onOwn` what the relay says in operations of our own.
  constructor(url, { onOpen, onMessage, onOwn, onClose }) {
    this.transport = new JsonTransport(url);
    this.transport.on("message", onMessage);
    this.transport.on("own", onOwn);
    this.ros = new Ros({ transportFactory: async () => this.transport });
    this.ros.on("connection", onOpen);
    this.ros.on("close", onClose);
    this.ros.on("error", () => {}); // a close with the reason follows each error
    this.ros.connect(url);
  }

  /** @param {TopicSpec} spec */
  topic({ name, type, throttleMs = 0, queueLength = throttleMs ? 1 : 0 }) {
    return new Topic({
      ros: this.ros,
      name,
      messageType: /** @type {string} */ (type), // roslib does without one, too
      throttle_rate: throttleMs,
      queue_length: queueLength,
      queue_size: 1,
      reconnect_on_close: false,
    });
  }

  // `onRefused(why)` of the spec is called when the server refuses the subscription.
  subscribe(spec, handler) {
    const topic = this.topic(spec);
    topic.subscribe(handler);
    if (spec.onRefused) this.onRefusal(topic.subscribeId, spec.onRefused);
    return {
      end: () => {
        topic.unsubscribe();
        this.ros.off(`status:${topic.subscribeId}`);
      },
    };
  }

  // What is published may carry `robotether`, the timestamp of a drive command, which roslib has no place for.
  // `onRefused(why)` of the spec is called for each message that the server refused.
  advertise(spec) {
    const topic = this.topic(spec);
    topic.advertise();
    const id = spec.onRefused && this.newId(`publish:${spec.name}`);
    if (id) this.onRefusal(id, spec.onRefused);
    return {
      publish: (msg, robotether) => this.transport.send({ op: "publish", id, topic: spec.name, msg, robotether }),
      end: () => {
        topic.unadvertise();
        if (id) this.ros.off(`status:${id}`);
      },
    };
  }

  // Settles with {ok, values} for any answer, also for one that says that the call failed, and for the server's
  // refusal, which is no answer of the robot's: roslib would wait for that for ever.
  call(service, args, type) {
    const id = this.newId(`call_service:${service}`);
    return new Promise((resolve) => {
      const settle = (answer) => {
        this.ros.off(id);
        this.ros.off(`status:${id}`);
        resolve(answer);
      };
      this.ros.on(id, (/** @type {any} */ { result, values }) => settle({ ok: Boolean(result), values }));
      this.onRefusal(id, (why) => settle({ ok: false, values: why }));
      this.transport.send({ op: "call_service", id, service, type, args });
    });
  }

  // By what the server says of the message with this id.
  onRefusal(id, act) {
    this.ros.on(`status:${id}`, (/** @type {any} */ { level, msg }) => level === "error" && act(msg));
  }

  newId(beginning) {
    this.ids = (this.ids ?? 0) + 1;
    return `${beginning}:${this.ids}`;
  }

  // Sends an operation of our own now or not at all, and says which.
  send(operation) {
    const open = this.transport.isOpen();
    if (open) this.transport.send(operation);
    return open;
  }

  get backlog() {
    return this.transport.backlog;
  }

  close() {
    this.transport.close();
  }
}

// The way roslib's Ros sends and receives: JSON text over a WebSocket, without the decoders for
// compressed messages that roslib brings (the pages never ask for compression).
// Operations of our own (docs/reference/protocols.md) go to `own` handlers alone: roslib does not know them.
const OWN = "robotether.";

class JsonTransport {
  constructor(url) {
    this.handlers = { open: [], close: [], error: [], message: [], own: [] };
    this.socket = new WebSocket(url);
    this.socket.onopen = (event) => this.emit("open", event);
    this.socket.onclose = (event) => this.emit("close", event);
    this.socket.onerror = (event) => this.emit("error", event);
    this.socket.onmessage = ({ data }) => this.receive(data);
  }

  on(event, handler) {
    this.handlers[event].push(handler);
    return this;
  }

  emit(event, value) {
    for (const handler of this.handlers[event]) handler(value);
  }

  receive(data) {
    if (typeof data !== "string") return;
    let message;
    try {
      message = JSON.parse(data);
    } catch {
      return; // one broken message from a robot must not end the session
    }
    if (message && typeof message.op === "string") this.emit(kind(message), message);
  }

  send(message) {
    this.socket.send(JSON.stringify(message));
  }

  close() {
    this.socket.close();
  }

  // Bytes that the browser has taken and the network has not.
  get backlog() {
    return this.socket.bufferedAmount;
  }

  isConnecting() {
    return this.socket.readyState === WebSocket.CONNECTING;
  }

  isOpen() {
    return this.socket.readyState === WebSocket.OPEN;
  }

  isClosing() {
    return this.socket.readyState === WebSocket.CLOSING;
  }

  isClosed() {
    return this.socket.readyState === WebSocket.CLOSED;
  }
}

const kind = ({ op }) => (op.startsWith(OWN) ? "own" : "message");

// Names and shapes of the ROS messages that the pages use, under their ROS 1 and ROS 2 names. Pure.
const TWIST = "geometry_msgs/Twist";
const TWIST_STAMPED = "geometry_msgs/TwistStamped";
const ACKERMANN_STAMPED = "ackermann_msgs/AckermannDriveStamped";
const DRIVE_TYPES = [TWIST, TWIST_STAMPED, ACKERMANN_STAMPED];

// Of a robot whose settings have none: about that of the small cars that take steering angles.
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
export function driveMessage(type, { forward, left = 0, turn }, /** @type {{wheelbase?: number | null}} */ { wheelbase } = {}) {
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

// The topic with the robot's speed: odometry before pose, the usual name before others.
export function speedTopic(topics) {
  const rank = ({ name, type }) => SPEED_TYPES.indexOf(plainType(type)) * 2 + (SPEED_TOPICS.includes(name) ? 0 : 1);
  return topics.filter(({ type }) => speedReader(type)).sort((a, b) => rank(a) - rank(b))[0];
}

// Poses in the plane are {x, y, theta} in m and rad (REP-103).
const POSE_READERS = {
  "nav_msgs/Odometry": ({ pose }) => planar(pose.pose),
  "geometry_msgs/PoseWithCovarianceStamped": ({ pose }) => planar(pose.pose),
  "turtlesim/Pose": ({ x, y, theta }) => ({ x, y, theta }),
};

// The function that reads a pose out of a message of this type, or undefined.
export const poseReader = (type) => POSE_READERS[plainType(type)];

// A geometry_msgs/Pose seen from above.
/** @param {{position?: {x: number, y: number}, orientation?: object}} pose */
export function planar({ position, orientation } = {}) {
  const { x, y, z, w } = { x: 0, y: 0, z: 0, w: 1, ...orientation };
  const theta = Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z));
  return { x: position?.x ?? 0, y: position?.y ?? 0, theta };
}

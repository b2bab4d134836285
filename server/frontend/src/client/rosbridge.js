// What goes over rosbridge: a link, which is one WebSocket, and the ROS messages on it.

/**
 * @typedef {{
 *   onOpen: () => void,
 *   onMessage: (message: object) => void,
 *   onOwn: (operation: any) => void,
 *   onClose: (event: CloseEvent) => void,
 * }} LinkHandlers
 * @typedef {{name: string, type?: string, throttleMs?: number, queueLength?: number, onRefused?: (why: string) => void, onUnread?: () => void}} TopicSpec
 */

// Operations of our own (docs/reference/protocols.md) are the relay's, and go to a handler of their own.
const OWN = "robotether.";

/** @type {(url: string, handlers: LinkHandlers) => Link} */
export function openLink(url, handlers) {
  return new Link(url, handlers);
}

// From its opening to its end; connection.js opens the next one, so that nothing is sent on that which was meant for this one.
export class Link {
  // `onMessage` gets what the robot says, `onOwn` what the relay says in operations of our own.
  /** @param {string} url @param {LinkHandlers} handlers */
  constructor(url, { onOpen, onMessage, onOwn, onClose }) {
    this.onMessage = onMessage;
    this.onOwn = onOwn;
    this.subscribers = new Map(); // by topic, a set of {handler, onUnread}
    this.replies = new Map(); // by the id of a message, the function that receives replies to it
    this.ids = 0;
    this.socket = new WebSocket(url);
    this.socket.onopen = onOpen;
    this.socket.onclose = onClose;
    this.socket.onmessage = ({ data }) => this.receive(parse(data) ?? unread(data));
  }

  // One broken message from a robot must not end the session.
  receive(message) {
    if (typeof message?.op !== "string") return;
    if (message.op.startsWith(OWN)) return this.onOwn(message);
    this.onMessage(message);
    if (message.op === "publish") this.deliver(message);
    else this.replies.get(message.id)?.(message);
  }

  deliver({ topic, msg }) {
    const isRead = typeof msg === "object" && msg !== null;
    for (const { handler, onUnread } of [...(this.subscribers.get(topic) ?? [])]) {
      if (isRead) handler(msg);
      else onUnread();
    }
  }

  // `onRefused(why)` of the spec is called when the server refuses the subscription, `onUnread()` for each message that cannot
  // be read. Gives {end}.
  /** @type {(spec: TopicSpec, handler: (message: any) => void) => {end: () => void}} */
  subscribe({ name: topic, type, throttleMs = 0, queueLength = throttleMs ? 1 : 0, onRefused, onUnread = () => {} }, handler) {
    const id = this.newId("subscribe", topic, onRefused);
    const subscriber = { handler, onUnread };
    this.subscribers.set(topic, (this.subscribers.get(topic) ?? new Set()).add(subscriber));
    this.send({ op: "subscribe", id, type, topic, compression: "none", throttle_rate: throttleMs, queue_length: queueLength });
    return {
      end: () => {
        this.subscribers.get(topic)?.delete(subscriber);
        this.replies.delete(id);
        this.send({ op: "unsubscribe", id, topic });
      },
    };
  }

  // What is published may carry `robotether`, the timestamp of a drive command.
  // `onRefused(why)` of the spec is called for each message that the server refused. Gives {publish, end}.
  /** @param {TopicSpec} spec */
  advertise({ name: topic, type, onRefused }) {
    const id = this.newId("advertise", topic);
    const publishId = onRefused && this.newId("publish", topic, onRefused);
    this.send({ op: "advertise", id, type, topic, latch: false, queue_size: 1 });
    return {
      publish: (msg, robotether) => this.send({ op: "publish", id: publishId, topic, msg, robotether }),
      end: () => {
        this.replies.delete(publishId);
        this.send({ op: "unadvertise", id, topic });
      },
    };
  }

  // Settles with {ok, values} for any answer, also for one that says that the call failed, and for the server's refusal.
  /** @type {(service: string, args: object, type?: string, timeout?: number) => Promise<{ok: boolean, values: any}>} */
  call(service, args, type, timeout) {
    const id = this.newId("call_service", service);
    return new Promise((resolve) => {
      const settle = (answer) => {
        this.replies.delete(id);
        resolve(answer);
      };
      const refused = refusal((why) => settle({ ok: false, values: why }));
      this.replies.set(id, (reply) => {
        if (reply.op === "service_response") settle({ ok: Boolean(reply.result), values: reply.values });
        else refused(reply);
      });
      this.send({ op: "call_service", id, service, type, args, timeout });
    });
  }

  newId(op, name, /** @type {((why: string) => void) | undefined} */ onRefused = undefined) {
    this.ids += 1;
    const id = `${op}:${name}:${this.ids}`;
    if (onRefused) this.replies.set(id, refusal(onRefused));
    return id;
  }

  // Sends an operation now or not at all, and says which: a browser complains of what is said on a socket that closes.
  send(operation) {
    const open = this.socket.readyState === WebSocket.OPEN;
    if (open) this.socket.send(JSON.stringify(operation));
    return open;
  }

  // Bytes that the browser has taken and the network has not.
  get backlog() {
    return this.socket.bufferedAmount;
  }

  // `code` says why, where the relay is to know.
  /** @param {number} [code] */
  close(code) {
    this.socket.close(code);
  }
}

// Receives what the server says of a message that it refuses.
const refusal =
  (act) =>
  ({ op, level, msg }) =>
    op === "status" && level === "error" && act(msg);

// JSON as Python writes it: rosbridge has NaN and Infinity in it for numbers that are none. Null for what is no such text.
export function parse(data) {
  try {
    return JSON.parse(data);
  } catch {
    return parsePythons(data);
  }
}

const TOPIC = /"topic"\s*:\s*"([^"\\]+)"/;
const ANSWER = /"op"\s*:\s*"service_response"/;
const ID = /"id"\s*:\s*"([^"\\]+)"/;

// What stands for a message that is not JSON: one of the topic that it names, with nothing in it, or a call that has failed.
function unread(data) {
  if (typeof data !== "string") return null;
  const [topic, id] = [TOPIC, ID].map((member) => member.exec(data)?.[1]);
  if (id && ANSWER.test(data)) return { op: "service_response", id, result: false, values: "its answer cannot be read" };
  return topic ? { op: "publish", topic, msg: null } : null;
}

const STRING_OR_NO_NUMBER = /"[^"\\]*(?:\\.[^"\\]*)*"|\bNaN\b|-?\bInfinity\b/g;
const IN_JSON = { NaN: "null", Infinity: "1e999", "-Infinity": "-1e999" }; // too large for a number, so infinite

function parsePythons(data) {
  try {
    return JSON.parse(data.replace(STRING_OR_NO_NUMBER, (part) => IN_JSON[part] ?? part));
  } catch {
    return null;
  }
}

// As the server writes it, and the robot then names it in its messages: a subscriber of `odom` would hear of no `/odom`.
export const fullName = (topic) => (topic.startsWith("/") ? topic : `/${topic}`);

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

// Whether messages of this type drive a robot.
export const isDriveType = (type) => DRIVE_TYPES.includes(plainType(type));

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

// What a robot does not know is missing, null, NaN or infinite in its messages: null here.
export const finite = (value) => (Number.isFinite(value) ? value : null);

// The member at a path such as "twist.linear.x"; undefined where one of its steps is missing.
const member = (message, path) => path.split(".").reduce((value, step) => value?.[step], message);

const SPEED_READERS = {
  "nav_msgs/Odometry": (message) => ({
    forward: finite(member(message, "twist.twist.linear.x")),
    left: finite(member(message, "twist.twist.linear.y")),
    turn: finite(member(message, "twist.twist.angular.z")),
  }),
  "turtlesim/Pose": ({ linear_velocity, angular_velocity }) => ({
    forward: finite(linear_velocity),
    left: 0, // a turtle has no other
    turn: finite(angular_velocity),
  }),
};

// The function that reads {forward, left, turn} out of a message of this type, each null where it is not known; or undefined.
export const speedReader = (type) => SPEED_READERS[plainType(type)];

// Poses in the plane are {x, y, theta} in m and rad (REP-103); those with a header name the frame that they are in, odometry the robot's own, too.
const POSE_READERS = {
  "nav_msgs/Odometry": ({ header, child_frame_id, pose }) => {
    const read = planar(pose?.pose);
    return read && { ...read, frame: header?.frame_id, base: child_frame_id };
  },
  "geometry_msgs/PoseWithCovarianceStamped": ({ header, pose }) => {
    const read = planar(pose?.pose);
    return read && { ...read, frame: header?.frame_id };
  },
  "turtlesim/Pose": (pose) => wholePose(pose),
};

// The function that reads a pose out of a message of this type, null where it is not known; or undefined.
export const poseReader = (type) => POSE_READERS[plainType(type)];

// A geometry_msgs/Pose seen from above; null where place or heading are not known.
/** @type {(pose?: null | {position?: {x: number, y: number}, orientation?: {x: number, y: number, z: number, w: number}}) => {x: number, y: number, theta: number} | null} */
export function planar(pose) {
  const { position, orientation } = pose ?? {};
  const rotation = unitQuaternion(orientation);
  return rotation && wholePose({ x: position?.x, y: position?.y, theta: headingOf(rotation) });
}

// A quaternion of any length as one of length 1; null for what is none, as one that nobody has set.
export function unitQuaternion(quaternion) {
  const { x, y, z, w } = quaternion ?? {};
  const length = [x, y, z, w].every(Number.isFinite) ? Math.hypot(x, y, z, w) : 0;
  return length > 0 && length < Infinity ? { x: x / length, y: y / length, z: z / length, w: w / length } : null;
}

const headingOf = ({ x, y, z, w }) => Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z));

const wholePose = ({ x, y, theta }) => ([x, y, theta].every(Number.isFinite) ? { x, y, theta } : null);

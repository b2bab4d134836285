import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { beforeEach, mock, test } from "node:test";

import { Discovery, cameraTopics, offeredCameras } from "../../src/topics/discovery.js";
import { chooseTopic, ownTopics } from "../../src/topics/ownTopics.js";

let found, discovery;

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setTimeout"] });
  found = [];
  discovery = new Discovery({ driveTopic: "/cmd_vel", onFound: (what) => found.push(what) });
});

const robot = (topics, driveType = "") => {
  const asked = [];
  const call = async (service, request) => {
    asked.push({ service, request });
    if (service === "/rosapi/get_ros_version") return { ok: true, values: { version: 2, distro: "humble" } };
    if (service === "/rosapi/topic_type") return { ok: true, values: { type: driveType } };
    return { ok: true, values: { topics: Object.keys(topics), types: Object.values(topics) } };
  };
  return { call, asked };
};

test("a whole robot is found in one round, and is asked again later", async () => {
  const { call, asked } = robot(
    { "/odom": "nav_msgs/msg/Odometry", "/camera/image_raw": "sensor_msgs/msg/Image" },
    "geometry_msgs/msg/Twist",
  );
  await discovery.run(call);
  mock.timers.tick(29_999);
  const topics = [
    { name: "/odom", type: "nav_msgs/msg/Odometry" },
    { name: "/camera/image_raw", type: "sensor_msgs/msg/Image" },
  ];
  const all = { topics, own: topics, others: [], answered: true };
  assert.deepEqual(found, [{ twistType: "geometry_msgs/msg/Twist", speed: topics[0], cameras: ["/camera/image_raw"], ...all }]);
  assert.deepEqual(asked.map(({ service }) => service).sort(), ["/rosapi/get_ros_version", "/rosapi/topic_type", "/rosapi/topics"]);
  mock.timers.tick(1);
  assert.ok(asked.length > 3);
  discovery.stop();
});

test("what shows as another robot's is left, and a driver that restarts or a silent rosapi changes nothing", async () => {
  const topicsOf = (name) => ({
    [`/${name}/odom`]: "nav_msgs/Odometry",
    [`/${name}/image_raw`]: "sensor_msgs/Image",
    [`/${name}/cmd_vel`]: "geometry_msgs/Twist",
  });
  const [before, a, b] = [topicsOf("b"), topicsOf("a"), topicsOf("b")];
  delete before["/b/cmd_vel"];
  let topics = before;
  const call = (service, request) => robot(topics).call(service, request);
  discovery = new Discovery({ driveTopic: "/a/cmd_vel", onFound: ({ speed, cameras }) => found.push([speed?.name, ...cameras]) });
  for (const next of [before, b, { ...a, ...b }, {}, { ...b, "/odom": "nav_msgs/Odometry" }]) {
    topics = next;
    await discovery.run(call);
  }
  discovery.stop();
  const [hers, his] = ["a", "b"].map((name) => [`/${name}/odom`, `/${name}/image_raw`]);
  assert.deepEqual(found, [his, [undefined], hers, hers, hers]);
});

for (const [what, values] of [
  ["nothing", { topics: null, types: null, type: null }],
  ["numbers", { topics: [1, "/odom"], types: [2, 3], type: 4 }],
  ["objects", { topics: {}, types: {}, type: {} }],
]) {
  test(`a robot that answers ${what} in place of names is asked again`, async () => {
    let times = 0;
    const call = async () => ({ ok: true, values: (times++, values) });
    await discovery.run(call);
    const [{ speed, cameras, twistType, answered }] = found;
    assert.deepEqual([found.length, speed, cameras, twistType, answered], [1, undefined, [], "geometry_msgs/Twist", false]);
    const before = times;
    mock.timers.tick(5000);
    assert.ok(times > before);
    discovery.stop();
  });
}

test("which topics a robot has is known once it has named one with its type, and on the next link no more", async () => {
  let topics = {};
  const link = () => (service, request) => robot(topics).call(service, request);
  const [first, second] = [link(), link()];
  for (const [call, answer] of [
    [first, {}],
    [first, { "/odom": "" }],
    [first, { "/rosout": "rosgraph_msgs/Log" }],
    [first, {}],
    [second, {}],
  ]) {
    topics = answer;
    await discovery.run(call);
  }
  discovery.stop();
  const answers = found.map(({ answered }) => answered);
  assert.deepEqual(answers, [false, false, true, true, false]);
});

test("a topic that is named twice is in no doubt", async () => {
  const type = "nav_msgs/Odometry";
  await discovery.run(async () => ({ ok: true, values: { topics: ["/odom", "/odom"], types: [type, type] } }));
  discovery.stop();
  assert.deepEqual([found[0].speed, found[0].topics.length], [{ name: "/odom", type }, 1]);
});

test("an answer that comes after the connection ended is ignored", async () => {
  const running = discovery.run(robot({}).call);
  discovery.stop();
  await running;
  assert.deepEqual(found, []);
});

test("configured cameras are all that are offered, and before anything is known the usual one", () => {
  const configured = [{ topic: "/x", name: "Front", turned_deg: 180 }];
  assert.equal(offeredCameras({ configured, known: ["/y"] }), configured);
  assert.deepEqual(offeredCameras({ known: ["/y"] }), [{ topic: "/y", name: "y", turned_deg: 0 }]);
  assert.equal(offeredCameras({})[0].topic, "/camera/image_raw");
  assert.equal(offeredCameras({ guess: "/rear" })[0].topic, "/rear");
});

test("a camera is named by what tells it from the others", () => {
  const names = (...known) => offeredCameras({ known }).map(({ name }) => name);
  assert.deepEqual(names("/front/image_raw", "/arm/rear/image_rect_color", "/image_raw"), ["arm/rear", "front", "/image_raw"]);
  assert.deepEqual(names("/front/image_raw", "/front/image_mono"), ["/front/image_mono", "/front/image_raw"]);
});

const topic = (name, type = "sensor_msgs/msg/LaserScan") => ({ name, type });
const names = (topics) => topics.map(({ name }) => name);
const choose = (kind, driveTopic, ...topics) => chooseTopic(kind, topics, { driveTopic });

const CASES = JSON.parse(readFileSync(new URL("ros_graphs.json", import.meta.url), "utf8"));

for (const { why, drive_topic: driveTopic, topics, own, odometry, cameras } of CASES) {
  test(`of one graph page and agent choose the same: ${why}`, () => {
    const found = ownTopics(
      Object.entries(topics).map(([name, type]) => ({ name, type })),
      driveTopic,
    );
    assert.deepEqual(names(found).sort(), own);
    assert.equal(choose("odometry", driveTopic, ...found).topic?.name ?? null, odometry);
    const known = cameraTopics(found);
    assert.deepEqual(known.length ? offeredCameras({ known }).map(({ topic }) => topic) : [], cameras);
  });
}

test("of several that fit equally well none is chosen, unless the settings name one", () => {
  const scans = [topic("/rear/scan"), topic("/front/scan")];
  assert.deepEqual(choose("scan", "/cmd_vel", ...scans), { topic: undefined, candidates: ["/front/scan", "/rear/scan"] });
  const named = (name) => chooseTopic("scan", scans, { named: name, driveTopic: "/cmd_vel" });
  assert.deepEqual(named("/rear/scan"), { topic: scans[0], candidates: [] });
  assert.deepEqual(named("/hidden").topic, topic("/hidden", "sensor_msgs/LaserScan"));
  assert.deepEqual(choose("map", "/cmd_vel", ...scans), { topic: undefined, candidates: [] });
});

test("frames come on the usual topics, or on those of the robot's namespace", () => {
  const usual = [topic("/tf", "tf2_msgs/msg/TFMessage"), topic("/tf_static", "tf2_msgs/msg/TFMessage")];
  const ours = [topic("/a1/tf", "tf/tfMessage"), topic("/a1/tf_static", "tf2_msgs/TFMessage"), topic("/x/tf", "std_msgs/String")];
  const frames = (driveTopic, ...all) => ["tf", "tfStatic"].map((kind) => choose(kind, driveTopic, ...all).topic);
  assert.deepEqual(frames("/cmd_vel", ...ours, ...usual), usual);
  assert.deepEqual(frames("/a1/cmd_vel", ...ours, ...usual), ours.slice(0, 2));
  assert.deepEqual(frames("/cmd_vel"), [undefined, undefined]);
});

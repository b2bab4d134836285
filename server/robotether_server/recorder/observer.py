"""Observes one robot as a person's page would: its own topics through rosbridge, and the frames of its cameras.

Each connection is opened again when it ends, for as long as the robot is recorded. What comes from a robot is taken for
nothing but data: names are names in a file, and a message that is not of its type is counted and left out.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import logging
import time
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NoReturn

import msgspec
from aiohttp import ClientError, ClientWebSocketResponse, WSMsgType
from msgspec import Raw, Struct
from robotether_common.codecs import CODECS
from robotether_common.frames import HEADER, KEY, MAX_CREDITS
from robotether_common.own_topics import own_topics
from robotether_common.ros import camera_topics

from robotether_server.contract.recordings import NAMESPACE
from robotether_server.contract.ros import POLICY_REFUSES
from robotether_server.db.recordings import MAX_TOPICS_LEFT_OUT, RecordableRobot
from robotether_server.problems import reason_in
from robotether_server.recorder.cdr import EncodingError, encoder_of
from robotether_server.recorder.channels import JSON_TEXT, CameraWriter, channel_of
from robotether_server.recorder.mcap_file import RecordedMessage
from robotether_server.recorder.relay_client import AGAIN_S, RelayClient
from robotether_server.recorder.ros_types import RosType, UnknownTypeError, short_name, type_of
from robotether_server.robot_json import read_robot_json
from robotether_server.tasks import end_tasks

log = logging.getLogger(__name__)

Write = Callable[[RecordedMessage], None]
OnLeftOut = Callable[[Sequence[str]], None]

# Interval at which a robot is asked again which topics it has.
DISCOVER_EVERY_S = 10.0
# Time limit for an answer of rosapi.
ANSWER_WITHIN_S = 5.0
# Minimum interval between two messages of a topic, except of types whose messages build on each other.
THROTTLE_MS = 100
UNTHROTTLED = frozenset(("tf", "tf_static", "diagnostics", "rosout"))
# Maximum number of a topic's messages that are so until others come, by the end of its name or by its type: each file
# begins with them. Static frames come from several programs.
MAX_LASTING = {"tf_static": 50, "robot_description": 1, "nav_msgs/OccupancyGrid": 1}
# Maximum number of topics and cameras of a robot. Of 64 topics observers may add none from 32 on, and the recorder must
# not keep them out; an agent has room for 8 cameras.
MAX_RECORDED_TOPICS, MAX_RECORDED_CAMERAS = 16, 8
MAX_TOPIC_LENGTH = 255
# Maximum number of topics that are looked at: each takes time that other robots lack.
MAX_TOPICS = 20_000
# Interval between two questions for the relay's clock.
CLOCK_EVERY_S = 10.0
# Interval without a key frame after which the recorder requests one: a reader cannot begin before it.
KEY_FRAME_EVERY_S = 10.0
# Types that would fill the uplink: cameras are recorded by their frames.
LARGE = frozenset(
    [
        "sensor_msgs/Image",
        "sensor_msgs/CompressedImage",
        "sensor_msgs/PointCloud",
        "sensor_msgs/PointCloud2",
        "stereo_msgs/DisparityImage",
        "nav2_msgs/VoxelGrid",
        "nav2_msgs/Costmap",
        "octomap_msgs/Octomap",
        "grid_map_msgs/GridMap",
        "audio_common_msgs/AudioData",
        "theora_image_transport/Packet",
        "ffmpeg_image_transport_msgs/FFMPEGPacket",
        "shape_msgs/Mesh",
    ]
)
# What a drive is told by comes first; all others by name, and what programs write of themselves last.
FIRST = (
    "nav_msgs/Odometry",
    "turtlesim/Pose",
    "tf2_msgs/TFMessage",
    "tf/tfMessage",
    "geometry_msgs/Twist",
    "geometry_msgs/TwistStamped",
    "ackermann_msgs/AckermannDriveStamped",
    "sensor_msgs/LaserScan",
    "sensor_msgs/Imu",
    "sensor_msgs/JointState",
    "sensor_msgs/NavSatFix",
    "sensor_msgs/BatteryState",
    "geometry_msgs/PoseWithCovarianceStamped",
)
LAST = frozenset(
    [
        "diagnostic_msgs/DiagnosticArray",
        "rcl_interfaces/Log",
        "rcl_interfaces/ParameterEvent",
        "rosgraph_msgs/Log",
    ]
)


class ObservedMessage(Struct):
    """What rosbridge sends: a message of a topic, an answer to a call, or why a subscription brings nothing."""

    op: str
    topic: str = ""
    msg: Raw = Raw(b"{}")
    id: str | None = None
    values: Any = None
    result: bool = True
    level: str = ""


class TopicWriter:
    """Writes the messages of one topic; the first one of a robot that it cannot write is in the log."""

    def __init__(self, robot: str, topic: str, kind: str, ros_type: RosType | None) -> None:
        self.kind = kind
        self._name = f"robot {robot}: {topic[:100]!r}"
        self._channel = channel_of(topic, ros_type or JSON_TEXT)
        self._encode = encoder_of(ros_type or JSON_TEXT)
        self._is_typed = ros_type is not None
        self.unreadable = 0
        last_name = topic.rpartition("/")[2]
        self._max_lasting = MAX_LASTING.get(last_name) or MAX_LASTING.get(short_name(kind), 0)
        # The newest last.
        self.lasting: dict[bytes, RecordedMessage] = {}

    def message(self, msg: Raw, now_ns: int) -> RecordedMessage | None:
        """Return the message as it is written; None if it is none of its type."""
        try:
            data = bytes(msg)
            values = msgspec.json.decode(data) if self._is_typed else {"data": data.decode()}
            encoded = self._encode(values)
        except (EncodingError, msgspec.DecodeError, UnicodeDecodeError, RecursionError) as exc:
            if not self.unreadable:
                log.warning("%s has a message that is not recorded: %.200s", self._name, exc)
            self.unreadable += 1
            return None
        recorded = RecordedMessage(self._channel, now_ns, now_ns, 0, encoded)
        if self._max_lasting:
            self.lasting.pop(encoded, None)
            self.lasting[encoded] = recorded
            if len(self.lasting) > self._max_lasting:
                del self.lasting[next(iter(self.lasting))]
        return recorded


class RobotObserver:
    """Everything that one robot sends to observers, until `run` is cancelled; `drive_topic` gives its drive topic.

    `on_left_out` gets the topics that bring nothing or find no place now.
    """

    def __init__(
        self,
        client: RelayClient,
        robot: RecordableRobot,
        write: Write,
        drive_topic: Callable[[], str],
        on_left_out: OnLeftOut,
    ) -> None:
        self._client = client
        self._robot = robot
        self._write = write
        self._drive_topic = drive_topic
        self._on_left_out = on_left_out
        self._cameras: dict[str, asyncio.Task[None]] = {}
        # The newest connections.
        self._frames: dict[str, CameraObserver] = {}
        self._rosbridge: RosbridgeObserver | None = None

    def request_key_frames(self) -> None:
        """Request a key frame of each camera, which a new file needs."""
        for camera in self._frames.values():
            camera.request_key_frame()

    def lasting(self) -> list[RecordedMessage]:
        """Return the messages that are so until others come."""
        return [] if self._rosbridge is None else self._rosbridge.lasting()

    async def run(self) -> None:
        """Observe, for ever."""
        self._observe_cameras(self._robot.cameras)
        try:
            await self._again_and_again(self._observe_topics, "rosbridge")
        finally:
            tasks = list(self._cameras.values())
            await end_tasks(tasks)

    def _observe_cameras(self, cameras: Sequence[str]) -> None:
        """Observe these, too; those of the robot's page, if it names any, and no others."""
        for camera in self._robot.cameras or cameras:
            if camera not in self._cameras and len(self._cameras) < MAX_RECORDED_CAMERAS:
                work = partial(self._observe_camera, camera)
                self._cameras[camera] = asyncio.create_task(
                    self._again_and_again(work, f"camera {camera[:100]!r}")
                )

    async def _observe_topics(self) -> None:
        async with await self._client.open_rosbridge(self._robot) as socket:
            self._rosbridge = RosbridgeObserver(
                self._robot.name,
                socket,
                self._write,
                self._observe_cameras,
                drive_topic=self._drive_topic,
                on_left_out=self._on_left_out,
            )
            await self._rosbridge.run()

    async def _observe_camera(self, camera: str) -> None:
        async with await self._client.open_frames(self._robot, camera) as socket:
            observer = self._frames[camera] = CameraObserver(socket, camera, self._write)
            await observer.run()

    async def _again_and_again(self, work: Callable[[], Awaitable[None]], what: str) -> NoReturn:
        while True:
            try:
                await work()
            except (ClientError, OSError) as exc:
                log.debug("robot %s: no %s: %s", self._robot.name, what, reason_in(exc))
            except Exception:
                # What this robot sent must not end the recording of the rest.
                log.exception("robot %s: %s failed", self._robot.name, what)
            await asyncio.sleep(AGAIN_S)


class RosbridgeObserver:
    """One connection to a robot's rosbridge."""

    def __init__(
        self,
        robot: str,
        socket: ClientWebSocketResponse,
        write: Write,
        on_cameras: Callable[[Sequence[str]], None],
        *,
        drive_topic: Callable[[], str],
        on_left_out: OnLeftOut,
    ) -> None:
        self._robot = robot
        self._socket = socket
        self._write = write
        self._on_cameras = on_cameras
        self._drive_topic = drive_topic
        self._on_left_out = on_left_out
        self._writers: dict[str, TopicWriter] = {}
        # The topics that bring nothing, and whether that lasts; and those without a place.
        self._failing: dict[str, bool] = {}
        self._beyond: Sequence[str] = ()
        self._types: dict[str, RosType | None] = {}
        self._numbers = itertools.count(1)
        # Number of texts of which nobody knows what they are.
        self._unreadable = 0
        self._answers: dict[str, asyncio.Future[Mapping[str, Any]]] = {}

    def lasting(self) -> list[RecordedMessage]:
        """Return the messages that are so until others come."""
        return [each for writer in self._writers.values() for each in writer.lasting.values()]

    async def run(self) -> None:
        """Read until the connection ends."""
        discovering = asyncio.create_task(self._discover())
        try:
            async for message in self._socket:
                if message.type is WSMsgType.TEXT:
                    self._on_text(message.data)
        finally:
            await end_tasks([discovering])

    def _on_text(self, text: str) -> None:
        try:
            message = read_robot_json(text.encode(), ObservedMessage)
        except (msgspec.DecodeError, RecursionError) as exc:
            if not self._unreadable:
                log.warning("robot %s: what rosbridge sends cannot be read: %s", self._robot, exc)
            self._unreadable += 1
            return
        if message.op == "publish" and (writer := self._writers.get(message.topic)) is not None:
            self._failing.pop(message.topic, None)
            recorded = writer.message(message.msg, time.time_ns())
            if recorded is not None:
                self._write(recorded)
        elif message.op == "service_response" and message.id in self._answers:
            answer = self._answers.pop(message.id)
            is_good = message.result and isinstance(message.values, dict)
            if not answer.done():
                answer.set_result(message.values if is_good else {})
        elif message.op == "status" and message.level == "error" and message.id in self._writers:
            lasts = self._failing[message.id] = POLICY_REFUSES.encode() in bytes(message.msg)
            if lasts:
                del self._writers[message.id]
            self._report_left_out()

    def _report_left_out(self) -> None:
        self._on_left_out([*self._failing, *self._beyond][:MAX_TOPICS_LEFT_OUT])

    async def _discover(self) -> None:
        while True:
            answer = await self._call("topics") or {}
            pairs = _pairs(answer.get("topics"), answer.get("types"))
            topics = dict(itertools.islice(pairs, MAX_TOPICS))
            types = {topic: short_name(kind) for topic, kind in topics.items()}
            # Another robot on the same ROS graph would take the places of this one's. Of a robot whose drive topic is
            # not there all is recorded rather than nothing.
            drive_topic = self._drive_topic()
            own = own_topics(types, drive_topic if drive_topic in types else "")
            self._on_cameras(camera_topics(own))
            recordable = [
                topic
                for topic, kind in own.items()
                if not (topic.startswith(NAMESPACE) or kind in LARGE or self._failing.get(topic))
            ]
            # Of those that are worth the same, the ones that are recorded stay.
            recordable.sort(key=lambda name: (_rank(own[name]), name not in self._writers, name))
            chosen = recordable[:MAX_RECORDED_TOPICS]
            self._beyond = recordable[MAX_RECORDED_TOPICS:][:MAX_TOPICS_LEFT_OUT]
            self._report_left_out()
            for topic in chosen:
                if topic not in self._writers and len(self._writers) >= MAX_RECORDED_TOPICS:
                    await self._unsubscribe(
                        next(each for each in self._writers if each not in chosen)
                    )
                await self._subscribe(topic, topics[topic])
            await asyncio.sleep(DISCOVER_EVERY_S)

    async def _unsubscribe(self, topic: str) -> None:
        del self._writers[topic]
        self._failing.pop(topic, None)
        await self._send(op="unsubscribe", topic=topic)

    async def _subscribe(self, topic: str, kind: str) -> None:
        if (writer := self._writers.get(topic)) is not None:
            if writer.kind == kind and topic not in self._failing:
                is_asked_again = kind not in self._types and await self._type(kind) is not None
                if is_asked_again and self._writers.get(topic) is writer:
                    self._writers[topic] = TopicWriter(self._robot, topic, kind, self._types[kind])
                return
            # Its publisher has come back with another type; rosbridge passes none on while somebody has the old one.
            # Or the relay has refused it, for too many topics.
            await self._unsubscribe(topic)
        self._writers[topic] = TopicWriter(self._robot, topic, kind, await self._type(kind))
        # In whichever namespace.
        throttle_ms = 0 if topic.rpartition("/")[2] in UNTHROTTLED else THROTTLE_MS
        await self._send(
            op="subscribe",
            id=topic,
            type=kind,
            topic=topic,
            compression="none",
            throttle_rate=throttle_ms,
            queue_length=1 if throttle_ms else 0,
        )

    async def _type(self, kind: str) -> RosType | None:
        """Ask what messages of a type are made up of; None: nobody can say, or not yet, so they are written as text."""
        if kind not in self._types:
            answer = await self._call("message_details", type=kind)
            if answer is None:
                # A busy robot's rosapi may be too slow now, and answer later.
                return None
            try:
                self._types[kind] = type_of(kind, answer.get("typedefs"))
            except UnknownTypeError as exc:
                log.info("messages of type %r are recorded as text: %s", kind[:100], exc)
                self._types[kind] = None
        return self._types[kind]

    async def _call(self, service: str, **args: str) -> Mapping[str, Any] | None:
        """Call a service of rosapi; one that fails gives nothing, None: it did not answer in time."""
        number = f"recorder:call:{next(self._numbers)}"
        answer: asyncio.Future[Mapping[str, Any]] = asyncio.get_running_loop().create_future()
        self._answers[number] = answer
        await self._send(op="call_service", id=number, service=f"/rosapi/{service}", args=args)
        try:
            async with asyncio.timeout(ANSWER_WITHIN_S):
                return await answer
        except TimeoutError:
            self._answers.pop(number, None)
            return None

    async def _send(self, **message: Any) -> None:
        await self._socket.send_str(json.dumps(message))


class CameraObserver:
    """One connection to the frames of a camera."""

    def __init__(self, socket: ClientWebSocketResponse, camera: str, write: Write) -> None:
        self._socket = socket
        self._camera = camera
        self._write = write
        self._writers: dict[int, CameraWriter] = {}
        # How far Unix time is ahead of the relay's clock; None until it is known.
        self._ahead_ms: float | None = None
        # When the last key frame came or was requested, by the monotonic clock.
        self._key_at = 0.0

    def request_key_frame(self) -> None:
        """Request a key frame with the next frame that is none."""
        self._key_at = float("-inf")

    async def run(self) -> None:
        """Read until the connection ends."""
        codecs = [codec.name for codec in CODECS.values()]
        # The answer comes before the first frame, whose time it says.
        await self._send(op="clock_sync", t_ms=0)
        await self._send(op="stream_request", codecs=codecs)
        await self._send(op="credit", frames=MAX_CREDITS)
        asking = asyncio.create_task(self._ask_clock())
        try:
            async for message in self._socket:
                if message.type is WSMsgType.BINARY:
                    await self._on_frame(message.data)
                elif message.type is WSMsgType.TEXT:
                    self._on_text(message.data)
        finally:
            await end_tasks([asking])

    async def _on_frame(self, data: bytes) -> None:
        number, flags, _, sequence, taken_ms = HEADER.unpack_from(data)
        if self._ahead_ms is not None:
            writer = self._writers.get(number)
            if writer is None:
                writer = self._writers[number] = CameraWriter(self._camera, CODECS[number].name)
            taken_ns = int((taken_ms + self._ahead_ms) * 1e6)
            self._write(
                writer.message(
                    data[HEADER.size :], log_ns=time.time_ns(), taken_ns=taken_ns, sequence=sequence
                )
            )
        await self._send(op="credit", frames=1, taken=sequence)
        now = time.monotonic()
        if flags & KEY or not CODECS[number].depends_on_earlier:
            self._key_at = now
        elif now - self._key_at >= KEY_FRAME_EVERY_S:
            self._key_at = now
            await self._send(op="key_frame")

    def _on_text(self, text: str) -> None:
        message = json.loads(text)
        if message.get("op") == "clock_sync":
            self._ahead_ms = time.time() * 1000 - message["sender_ms"]

    async def _ask_clock(self) -> None:
        while True:
            await asyncio.sleep(CLOCK_EVERY_S)
            await self._send(op="clock_sync", t_ms=0)

    async def _send(self, **message: Any) -> None:
        await self._socket.send_str(json.dumps(message))


def _rank(kind: str) -> int:
    return FIRST.index(kind) if kind in FIRST else len(FIRST) + (kind in LAST)


def _pairs(topics: object, types: object) -> Iterator[tuple[str, str]]:
    if not isinstance(topics, list) or not isinstance(types, list):
        return
    for pair in zip(topics, types, strict=False):
        if all(isinstance(name, str) and len(name) <= MAX_TOPIC_LENGTH for name in pair):
            yield pair

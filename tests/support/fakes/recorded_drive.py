"""A recorded drive of a made-up robot, and its truth: each frame has its number in its pixels, each command its time.

Frames get lost, come late and stand still; drivers pause, change, and stop the robot. Times are whole ms from
`BASE_NS`.
"""

from __future__ import annotations

import random
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import av
import numpy as np
from av.video.frame import PictureType
from numpy.typing import NDArray
from robotether_server.recorder.cdr import encoder_of
from robotether_server.recorder.channels import OWN_TOPICS, CameraWriter, channel_of
from robotether_server.recorder.mcap_file import McapFile, RecordedMessage
from robotether_server.recorder.ros_types import RosType, type_of
from sim_robot.graph import make_graph
from sim_robot.messages import ROS_2
from sim_robot.rosbridge import rosapi

BASE_NS = 1_800_000_000 * 10**9
MS = 10**6
WIDTH, HEIGHT, BITS = 96, 64, 12
COMMAND_EVERY_MS, STATE_EVERY_MS, KEY_EVERY = 50, 40, 10
# Time from a lease to its first command.
FIRST_COMMAND_MS = 150
# Greatest error of a time that is made up of float32.
ROUNDING_MS = 1e-3


class TrueFrame(NamedTuple):
    """A frame: its number in its pixels, that of the relay, and when it was taken, recorded and shown to the driver."""

    number: int
    sequence: int
    taken_ms: int
    log_ms: int
    shown_ms: int
    is_recorded: bool


class TrueCommand(NamedTuple):
    """A command, and the number in the pixels of the frame of each camera that its driver had seen."""

    at_ms: int
    fence: int
    is_sent: bool
    speed: float
    seen: Mapping[str, int]


@dataclass
class RecordedDrive:
    """What happened; `drivers` are the spans in ms in which each drove, with a fence that counts from 1."""

    seed: int
    codecs: Mapping[str, str] = field(default_factory=lambda: {"/front/image_raw": "jpeg"})
    seconds: float = 8.0
    fps: int = 15
    # Shares of frames that nobody gets, that the recorder alone misses, and of commands that are too old.
    lost: float = 0.0
    missed: float = 0.0
    refused: float = 0.0
    # Maximum delay of frames on their way to the driver.
    delay_ms: int = 200
    drivers: tuple[tuple[int, int], ...] = ((200, 7900),)
    # Number of the first frame of another size, of JPEG.
    other_from: int = 2**BITS
    other_size: tuple[int, int] = (193, 129)
    # Spans in ms in which the driver's screen stands still, nobody presses a key, and the robot is stopped.
    frozen: tuple[tuple[int, int], ...] = ()
    idle: tuple[tuple[int, int], ...] = ()
    stopped: tuple[tuple[int, int], ...] = ()

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)
        self.frames = {camera: list(self._frames(codec)) for camera, codec in self.codecs.items()}
        self.commands = list(self._commands())
        self.states_ms = range(0, int(self.seconds * 1000), STATE_EVERY_MS)

    def _frames(self, codec: str) -> Iterator[TrueFrame]:
        chance = self._random.random
        # Numbers begin anywhere, and may pass their end.
        sequence, shown_ms, log_ms = 2**32 - self._random.randint(1, 300), 0, 0
        is_missed = False
        for number in range(int(self.seconds * self.fps)):
            if chance() < self.lost:
                continue
            taken_ms = number * 1000 // self.fps + self._random.randint(0, 5)
            log_ms = max(log_ms + 1, taken_ms + self._random.randint(3, 90))
            shown_ms = max(shown_ms + 1, taken_ms + self._random.randint(10, 10 + self.delay_ms))
            # The recorder goes on at a key frame.
            is_missed = chance() < self.missed or (
                is_missed and codec != "jpeg" and number % KEY_EVERY > 0
            )
            yield TrueFrame(
                number, (sequence + number) % 2**32, taken_ms, log_ms, shown_ms, not is_missed
            )

    def _commands(self) -> Iterator[TrueCommand]:
        for fence, (from_ms, to_ms) in enumerate(self.drivers, 1):
            for at_ms in range(from_ms + FIRST_COMMAND_MS, to_ms, COMMAND_EVERY_MS):
                if not _within(at_ms, self.idle):
                    yield TrueCommand(
                        at_ms,
                        fence,
                        self._random.random() >= self.refused,
                        at_ms / 1000,
                        self._seen(at_ms),
                    )

    def _seen(self, at_ms: int) -> Mapping[str, int]:
        pressed_ms = at_ms - 20
        for from_ms, to_ms in self.frozen:
            if from_ms <= pressed_ms < to_ms:
                pressed_ms = from_ms
        newest = {
            camera: [frame.number for frame in frames if frame.shown_ms <= pressed_ms][-1:]
            for camera, frames in self.frames.items()
        }
        return {camera: numbers[0] for camera, numbers in newest.items() if numbers}

    def fence_at(self, at_ms: float) -> int:
        spans = enumerate(self.drivers, 1)
        return next((fence for fence, span in spans if _within(at_ms, (span,))), 0)

    def is_stopped(self, at_ms: float) -> bool:
        return _within(at_ms, self.stopped)

    def write(
        self,
        path: Path,
        extra: Iterable[RecordedMessage] = (),
        images: Mapping[int, bytes] = MappingProxyType({}),
    ) -> Path:
        """Write the recording as the recorder does, with further messages, and other data of frames by their number."""
        messages = [*self.messages(images), *extra]
        return write_all(path, sorted(messages, key=lambda message: message.log_ns))

    def messages(
        self, images: Mapping[int, bytes] = MappingProxyType({})
    ) -> Iterator[RecordedMessage]:
        for camera, frames in self.frames.items():
            codec = self.codecs[camera]
            writer = CameraWriter(camera, codec)
            for frame, data in zip(frames, self._encoded(codec, frames), strict=True):
                if frame.is_recorded:
                    yield writer.message(
                        images.get(frame.number, data),
                        log_ns=BASE_NS + frame.log_ms * MS,
                        taken_ns=BASE_NS + frame.taken_ms * MS,
                        sequence=frame.sequence,
                    )
        for command in self.commands:
            yield own_message("commands", self.command_members(command), command.at_ms, late_ms=4)
        yield from self._controls()
        yield from (odometry(at_ms, at_ms / 1000, float(self.seed)) for at_ms in self.states_ms)

    def _encoded(self, codec: str, frames: list[TrueFrame]) -> Iterator[bytes]:
        usual, other = encoder_of_frames(codec), encoder_of_frames(codec, self.other_size)
        for frame in frames:
            encoder = other if frame.number >= self.other_from else usual
            image = av.VideoFrame.from_ndarray(picture(frame.number), format="rgb24")
            image = image.reformat(encoder.width, encoder.height, encoder.pix_fmt)
            image.pts = frame.taken_ms
            if frame.number % KEY_EVERY == 0:
                image.pict_type = PictureType.I
            [packet] = encoder.encode(image)
            yield bytes(packet)

    def command_members(self, command: TrueCommand) -> dict[str, Any]:
        sequences = {
            camera: {frame.number: frame.sequence for frame in frames}
            for camera, frames in self.frames.items()
        }
        return {
            "topic": "/cmd_vel",
            "person": f"driver {command.fence}",
            "fence": command.fence,
            "age_ms": 20.0,
            "outcome": "sent" if command.is_sent else "too_old",
            "speed_m_s": command.speed,
            "turn_rad_s": None,
            "message": f'{{"linear":{{"x":{command.speed}}},"angular":{{"z":0.5}}}}',
            "seen_cameras": list(command.seen),
            "seen_frames": [sequences[camera][number] for camera, number in command.seen.items()],
        }

    def _controls(self) -> Iterator[RecordedMessage]:
        changes_ms = {0, *(at_ms for span in (*self.drivers, *self.stopped) for at_ms in span)}
        for at_ms in sorted(changes_ms):
            fence = self.fence_at(at_ms)
            members = {
                "online": True,
                "driver": f"driver {fence}" if fence else "",
                "fence": fence,
                "stopped": self.is_stopped(at_ms),
                "stopped_by": "",
                "stop_confirmed": False,
                "guard": "ready",
            }
            yield own_message("control", members, at_ms)


def write_all(path: Path, messages: Iterable[RecordedMessage]) -> Path:
    """Write messages in this order."""
    file = McapFile(path)
    for message in messages:
        file.add(message)
        if file.is_full:
            file.end_chunk()
    file.finish()
    return path


def _within(at_ms: float, spans: tuple[tuple[int, int], ...]) -> bool:
    return any(from_ms <= at_ms < to_ms for from_ms, to_ms in spans)


def own_message(
    topic: str, members: dict[str, Any], at_ms: int, late_ms: int = 0
) -> RecordedMessage:
    own, at_ns = OWN_TOPICS[topic], BASE_NS + at_ms * MS
    stamp = dict(zip(("sec", "nanosec"), divmod(at_ns, 10**9), strict=True))
    data = own.encode({"stamp": stamp, **members})
    return RecordedMessage(own.channel, at_ns + late_ms * MS, at_ns, 0, data)


def _odometry_type() -> RosType:
    graph = make_graph(ROS_2)
    rosapi.offer(graph)
    [details] = [each for each in graph.services.all() if each.name.endswith("message_details")]
    kind = "nav_msgs/Odometry"
    return type_of(kind, details.handler({"type": kind})["typedefs"])


ODOMETRY = _odometry_type()


def odometry(at_ms: int, x: float, y: float = 0.0, topic: str = "/odom") -> RecordedMessage:
    zero = {"x": 0.0, "y": 0.0, "z": 0.0}
    message = {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "odom"},
        "child_frame_id": "base",
        "pose": {
            "pose": {"position": {**zero, "x": x, "y": y}, "orientation": {**zero, "w": 1.0}},
            "covariance": [0.0] * 36,
        },
        "twist": {"twist": {"linear": zero, "angular": zero}, "covariance": [0.0] * 36},
    }
    at_ns = BASE_NS + at_ms * MS
    return RecordedMessage(
        channel_of(topic, ODOMETRY), at_ns, at_ns, 0, encoder_of(ODOMETRY)(message)
    )


def encoder_of_frames(codec: str, size: tuple[int, int] = (WIDTH, HEIGHT)) -> Any:
    encoder: Any = av.CodecContext.create({"jpeg": "mjpeg", "h264": "libx264"}[codec], "w")
    encoder.width, encoder.height = size
    encoder.pix_fmt = "yuvj420p" if codec == "jpeg" else "yuv420p"
    encoder.time_base = Fraction(1, 1000)
    encoder.gop_size = 10_000
    if codec == "h264":
        encoder.options = {"tune": "zerolatency", "preset": "ultrafast"}
    return encoder


def picture(number: int) -> NDArray[np.uint8]:
    column = WIDTH // BITS
    bits = [(number >> bit & 1) * 200 + 20 for bit in range(BITS)]
    row = np.repeat(np.array(bits, np.uint8), column)
    return np.broadcast_to(row[None, :, None], (HEIGHT, WIDTH, 3)).copy()


def number_in(image: NDArray[Any]) -> int:
    columns = image.mean(axis=(0, 2)).reshape(BITS, -1).mean(axis=1)
    return sum(1 << bit for bit, value in enumerate(columns) if value > 120)


class Row(NamedTuple):
    """What a dataset has of a step; `numbers` are read from the pixels, in the order of the cameras."""

    seed: int
    numbers: tuple[int, ...]
    ages_s: tuple[float, ...]
    x: float
    speed: float


def true_row(drive: RecordedDrive, at_ms: float) -> Row | None:
    """What a dataset must have of a time; None: nothing, as it is frozen, not driven or not known."""
    fence = drive.fence_at(at_ms)
    before = [
        command for command in drive.commands if command.at_ms <= at_ms and command.fence == fence
    ]
    if not before or before[-1].seen.keys() != drive.frames.keys():
        return None
    seen = [
        frame
        for camera, frames in drive.frames.items()
        for frame in frames
        if frame.number == before[-1].seen[camera]
    ]
    ages_ms = [at_ms - frame.taken_ms for frame in seen]
    if max(ages_ms) > 1000 + ROUNDING_MS or not all(frame.is_recorded for frame in seen):
        return None
    sent = [command for command in before if command.is_sent]
    in_force = sent and at_ms - sent[-1].at_ms <= 500 + ROUNDING_MS and not drive.is_stopped(at_ms)
    return Row(
        drive.seed,
        tuple(frame.number for frame in seen),
        tuple(age_ms / 1000 for age_ms in ages_ms),
        max(state_ms for state_ms in drive.states_ms if state_ms <= at_ms) / 1000,
        sent[-1].speed if in_force else 0.0,
    )


def pairing_errors(drives: Iterable[RecordedDrive], rows: Iterable[Row]) -> list[str]:
    """Compare rows with the truth of their times, which follow from when a frame was taken and its age."""
    by_seed = {drive.seed: drive for drive in drives}
    errors = []
    for row in rows:
        drive = by_seed[row.seed]
        first = next(iter(drive.frames.values()))
        taken_ms = [frame.taken_ms for frame in first if frame.number == row.numbers[0]]
        at_ms = taken_ms[0] + row.ages_s[0] * 1000 + ROUNDING_MS / 2 if taken_ms else -1
        truth = true_row(drive, at_ms)
        if (
            truth is None
            or row.numbers != truth.numbers
            or not np.allclose(
                (*row.ages_s, row.x, row.speed), (*truth.ages_s, truth.x, truth.speed), 0, 1e-5
            )
        ):
            errors.append(f"at {at_ms:.3f} ms {row} in place of {truth}")
    return errors

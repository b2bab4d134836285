"""Records one robot: takes what its observer and the relay bring, and writes it into the files that are open.

Each recording has a file. With the setting on_stop the last seconds wait in memory for a file, too. Nothing here knows
the database; `service` decides which recordings there are.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robotether_server.contract.recordings import NS_PER_S, ros_time
from robotether_server.db.recordings import MAX_TOPICS_LEFT_OUT, Progress, RecordableRobot
from robotether_server.recorder.cdr import EncodingError
from robotether_server.recorder.channels import (
    OWN_TOPICS,
    UNKNOWN_CONTROL,
    left_out_note,
)
from robotether_server.recorder.mcap_file import McapFile, RecordedMessage
from robotether_server.recorder.observer import RobotObserver
from robotether_server.recorder.relay_client import RelayClient
from robotether_server.tasks import end_tasks

log = logging.getLogger(__name__)

# Time before a stop that is recorded with it.
BEFORE_STOP_S = 30.0
# Maximum size of what waits for a stop in memory, of one robot and of all.
MAX_WAITING_BYTES = 48 * 1024 * 1024
MAX_ALL_WAITING_BYTES = 512 * 1024 * 1024
# Size of a message in memory beside its data; a robot may send many that are empty.
MESSAGE_BYTES = 250
OWN_CHANNELS = frozenset(own.channel for own in OWN_TOPICS.values())


def path_of(folder: Path, recording_id: int) -> Path:
    """Return where the file of a recording is: its number is all that is in its name."""
    return folder / f"{recording_id:d}.mcap"


def set_aside(path: Path) -> None:
    """Rename a file that is there before its recording: of one that a backup which was put back does not know.

    Its number comes again, maybe for another robot, whose people must not get it.
    """
    with suppress(FileNotFoundError):
        path.rename(path.with_stem(f"{path.stem}-{time.time_ns()}"))


@dataclass
class OpenRecording:
    """A recording under way. `failure`: the code of why it ends, once it has to."""

    id: int
    file: McapFile
    began_at: float
    drivers: list[str] = field(default_factory=list)
    failure: str | None = None
    messages_left_out: int = 0
    topics_left_out: dict[str, None] = field(default_factory=dict)

    def progress(self) -> Progress:
        """Return how far it is."""
        drivers, topics = tuple(self.drivers), tuple(self.topics_left_out)
        return Progress(self.file.size, self.file.messages, drivers, self.messages_left_out, topics)

    def add(self, message: RecordedMessage) -> None:
        """Add a message; of a topic that finds no room the first one is noted in the file."""
        # What a robot sends must not keep out what its driver did.
        if message.channel in OWN_CHANNELS or self.file.has_room_for(message.channel):
            self.file.add(message)
            return
        if not self.messages_left_out:
            self.file.add(left_out_note(message))
        self.messages_left_out += 1
        self.note_left_out([message.channel.topic])

    def note_left_out(self, topics: Sequence[str]) -> None:
        """The file gets nothing of these topics from now on, maybe for a while."""
        for topic in topics:
            if len(self.topics_left_out) < MAX_TOPICS_LEFT_OUT:
                self.topics_left_out[topic] = None

    def note_driver(self, name: str) -> None:
        """Somebody drives the robot."""
        if name and name not in self.drivers:
            self.drivers.append(name)


class RecentMessages:
    """The messages of the last seconds, in bounded memory; `control` is the one of that topic before them."""

    def __init__(self, control: RecordedMessage | None = None) -> None:
        self.max_bytes = MAX_WAITING_BYTES
        self._control = control
        self._messages: deque[RecordedMessage] = deque()
        self._bytes = 0

    def add(self, message: RecordedMessage) -> None:
        """Add the newest."""
        self._messages.append(message)
        self._bytes += MESSAGE_BYTES + len(message.data)
        # A clock that was set back leaves what is from the future.
        while self._messages and (
            abs(message.log_ns - self._messages[0].log_ns) > BEFORE_STOP_S * NS_PER_S
            or self._bytes > self.max_bytes
        ):
            oldest = self._messages.popleft()
            self._bytes -= MESSAGE_BYTES + len(oldest.data)
            if oldest.channel == OWN_TOPICS["control"].channel:
                self._control = oldest

    def all(self) -> list[RecordedMessage]:
        """Return all that are kept, the oldest first, which begin with what was the case before them."""
        messages = list(self._messages)
        if messages and self._control is not None:
            messages.insert(0, self._control._replace(log_ns=messages[0].log_ns))
        return messages


@dataclass
class RobotState:
    """What the relay last said of a robot; None: nothing yet. Times are the monotonic clock's.

    `is_heard`: it still says so. `is_elsewhere`: another cell has the robot.
    """

    is_heard: bool = False
    is_elsewhere: bool = False
    online: bool | None = None
    driver: str = ""
    stopped: bool | None = None
    drive_topic: str = ""
    driven_until: float | None = None
    stopped_at: float | None = None
    offline_since: float | None = None

    def update(self, control: Mapping[str, Any], now: float) -> None:
        """Take over a message of the topic control."""
        stopped = bool(control.get("stopped"))
        if stopped and self.stopped is False:
            self.stopped_at = now
        driver = str(control.get("driver", ""))
        if self.driver and not driver:
            self.driven_until = now
        online = bool(control.get("online"))
        if online:
            self.offline_since = None
        elif self.offline_since is None:
            self.offline_since = now
        self.online, self.driver, self.stopped = online, driver, stopped
        self.drive_topic = str(control.get("drive_topic", ""))
        self.is_heard, self.is_elsewhere = True, bool(control.get("elsewhere"))

    def lose(self, now: float) -> None:
        """The relay is not heard any longer."""
        self.is_heard = self.is_elsewhere = False
        if self.offline_since is None:
            self.offline_since = now


class RobotRecorder:
    """One robot that is recorded, or may have to be at any time."""

    def __init__(self, client: RelayClient, robot: RecordableRobot, folder: Path) -> None:
        self.robot = robot
        self.state = RobotState()
        self.recordings: dict[int, OpenRecording] = {}
        self._recent: RecentMessages | None = None
        self._client = client
        self._folder = folder
        self._observer: RobotObserver | None = None
        self._observing: asyncio.Task[None] | None = None
        # The topics of which nothing comes now.
        self._left_out: Sequence[str] = ()
        # The last message of the topic control, with which each file begins, and what it says.
        self._control: RecordedMessage | None = None
        self._control_members: Mapping[str, Any] | None = None
        # When the newest recording began; no message of a file is older than its first.
        self._begun_ns = 0

    @property
    def is_collecting(self) -> bool:
        """Whether what comes is kept."""
        return bool(self.recordings) or self._recent is not None

    @property
    def keeps_recent(self) -> bool:
        """Whether the last seconds are kept in memory."""
        return self._recent is not None

    def update(self, robot: RecordableRobot) -> None:
        """Take over its settings; other cameras are observed at once."""
        if robot.cameras != self.robot.cameras:
            self._stop_observing()
        self.robot = robot
        self._observe()

    def share_memory(self, robots: int) -> None:
        """Keep no more of the last seconds than this number of robots may together."""
        if self._recent is not None:
            self._recent.max_bytes = min(MAX_WAITING_BYTES, MAX_ALL_WAITING_BYTES // robots)

    def keep_recent(self, keeps: bool) -> None:
        """Keep the last seconds in memory, or no longer."""
        if keeps != (self._recent is not None):
            self._recent = RecentMessages(self._control) if keeps else None
        self._observe()

    def begin(self, recording_id: int, *, with_recent: bool = False) -> OpenRecording:
        """Begin a recording, with the last seconds if they are kept; raise OSError."""
        path = path_of(self._folder, recording_id)
        set_aside(path)
        file = McapFile(path)
        recording = OpenRecording(recording_id, file, time.monotonic())
        recording.note_driver(self.state.driver)
        recording.note_left_out(self._left_out)
        self.recordings[recording_id] = recording
        self._begun_ns = time.time_ns()
        recent = self._recent.all() if with_recent and self._recent is not None else []
        if not recent and self._control is not None:
            recent = [self._control._replace(log_ns=self._begun_ns)]
        begins_ns = recent[0].log_ns if recent else self._begun_ns
        lasting = [] if self._observer is None else self._observer.lasting()
        # The last seconds have some: at a stop none must take the uplink.
        if self._observer is not None and not with_recent:
            self._observer.request_key_frames()
        before = [each._replace(log_ns=begins_ns) for each in lasting if each.log_ns < begins_ns]
        for message in (*before, *recent):
            self._write_to(recording, message)
        self._observe()
        return recording

    def end(self, recording_id: int) -> OpenRecording:
        """End a recording; its file is whole, unless the disk fails."""
        recording = self.recordings.pop(recording_id)
        try:
            recording.file.finish()
        except OSError as exc:
            log.warning("recording %d: cannot write its end: %s", recording_id, exc)
        self._observe()
        return recording

    def on_event(self, topic: str, message: Mapping[str, Any]) -> None:
        """The relay sent what it knows."""
        if topic == "control":
            self.state.update(message, time.monotonic())
            for recording in self.recordings.values():
                recording.note_driver(self.state.driver)
            if self.state.is_elsewhere:
                # What this cell's relay says of it is not so there.
                message = {**UNKNOWN_CONTROL, "stamp": message["stamp"]}
        self._write_own(topic, message, time.time_ns())

    def on_lost(self, heard_ns: int) -> None:
        """The relay is lost, or something of what it sent, after this time."""
        self.state.lose(time.monotonic())
        heard_ns = max(heard_ns, self._begun_ns)
        self._write_own("control", {**UNKNOWN_CONTROL, "stamp": ros_time(heard_ns)}, heard_ns)

    def _write_own(self, topic: str, message: Mapping[str, Any], at_ns: int) -> None:
        own = OWN_TOPICS.get(topic)
        if own is None:
            return
        with suppress(EncodingError):
            recorded = RecordedMessage(own.channel, at_ns, at_ns, 0, own.encode(message))
            if topic == "control":
                # Round trips change the robot object each 2 s; readers look for changes of this in a file's index.
                members = {name: message.get(name) for name in UNKNOWN_CONTROL}
                if members == self._control_members:
                    return
                self._control, self._control_members = recorded, members
            self.write(recorded)

    def on_left_out(self, topics: Sequence[str]) -> None:
        """The robot has topics of which nothing comes now."""
        self._left_out = topics
        for recording in self.recordings.values():
            recording.note_left_out(topics)

    def write(self, message: RecordedMessage) -> None:
        """Write a message into all files."""
        if self._recent is not None:
            self._recent.add(message)
        for recording in self.recordings.values():
            self._write_to(recording, message)

    def flush(self) -> None:
        """Hand what waits to the kernel."""
        for recording in self.recordings.values():
            self._flush(recording)

    async def close(self) -> None:
        """End all; the recorder stops."""
        for recording_id in list(self.recordings):
            self.end(recording_id)
        self.keep_recent(False)
        observing = self._observing
        if observing is not None:
            await end_tasks([observing])

    def _write_to(self, recording: OpenRecording, message: RecordedMessage) -> None:
        if recording.failure is None:
            recording.add(message)
            if recording.file.is_full:
                self._flush(recording)

    def _flush(self, recording: OpenRecording) -> None:
        if recording.failure is not None:
            return
        try:
            recording.file.end_chunk()
        except OSError as exc:
            log.warning("recording %d ends: cannot write: %s", recording.id, exc)
            recording.failure = "disk_full"

    def _drive_topic(self) -> str:
        return self.state.drive_topic

    def _observe(self) -> None:
        if self.is_collecting and self._observing is None:
            self._observer = RobotObserver(
                self._client, self.robot, self.write, self._drive_topic, self.on_left_out
            )
            self._observing = asyncio.create_task(self._observer.run())
        elif not self.is_collecting:
            self._stop_observing()

    def _stop_observing(self) -> None:
        if self._observing is not None:
            self._observing.cancel()
            self._observer, self._observing, self._left_out = None, None, ()

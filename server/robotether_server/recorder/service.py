"""Decides which recordings there are: by what people ask for, robots' settings, limits of time and size, and rights.

`main` runs one `RecorderService`. Once a second it compares what the database asks for with what is recorded. A right
that ends, a stop of the recording, or its deletion so takes effect within two seconds.
"""

from __future__ import annotations

import asyncio
import datetime as dt
import logging
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from robotether_server.contract.recordings import NS_PER_S
from robotether_server.db.fleet import RECORDER
from robotether_server.db.recordings import (
    MAX_ASKED_S,
    Progress,
    RecordableRobot,
    RecordingCause,
    RecordingRow,
)
from robotether_server.disks import read_space
from robotether_server.recorder.mcap_file import repair
from robotether_server.recorder.relay_client import RelayChannel, RelayClient
from robotether_server.recorder.robot_recorder import (
    BEFORE_STOP_S,
    RobotRecorder,
    RobotState,
    path_of,
    set_aside,
)
from robotether_server.recorder.store import RecorderStore, RecordingEnd
from robotether_server.settings.server import RecorderSettings
from robotether_server.tasks import end_tasks
from robotether_server.times import utc_now

log = logging.getLogger(__name__)

STEP_S = 1.0
# Interval at which what waits is handed to the kernel: a recorder that is killed loses no more.
FLUSH_EVERY_S = 0.5
PROGRESS_EVERY_S = 5.0
# Interval at which the size of all recordings is measured.
MEASURE_EVERY_S = 2.0
RETENTION_EVERY_S = 600.0
# Interval at which the disk is asked how full it is, and the database what the site's other machines have.
DISK_EVERY_S = 10.0
# Free space that recordings leave to relay and database: this part of the disk, at most this number of bytes.
MIN_FREE_PART, MAX_MIN_FREE_BYTES = 0.05, 1000**3
# Maximum length of each recording by the robot's settings, which goes on in another.
MAX_PIECE_S = 3600.0
# Time after a drive, a stop or a connection in which a recording by the robot's settings goes on.
DRIVE_GAP_S, AFTER_STOP_S, OFFLINE_S = 10.0, 30.0, 30.0
# Time after a file that could not be written in which none is begun by robots' settings.
PAUSE_S = 60.0
WHENS: tuple[RecordingCause, ...] = ("driven", "always", "on_stop")


class RecorderService:
    """All recordings of one cell."""

    def __init__(
        self, settings: RecorderSettings, client: RelayClient, store: RecorderStore
    ) -> None:
        self._settings = settings
        self._folder = settings.folder
        self._client = client
        self._store = store
        self.channel = RelayChannel(client, self.on_event, self.on_lost)
        self._robots: dict[int, RobotRecorder] = {}
        # Of each recording under way: its robot, its cause, and who asked.
        self._open: dict[int, tuple[RobotRecorder, RecordingCause, str]] = {}
        # Those that ended here, whose row may still say otherwise.
        self._ended: set[int] = set()
        # Some GB take minutes, in which all else goes on.
        self.repairs: set[asyncio.Task[None]] = set()
        # The code of why nothing more is recorded; None: it may be.
        self._full: str | None = None
        # Of all recordings of the site, and of those of its other cells.
        self._bytes = self._bytes_elsewhere = 0
        self._is_disk_low = False
        self._measured_at = float("-inf")
        # Until when nothing is begun by robots' settings, after a file that could not be.
        self._paused_until = 0.0
        self._progress_at = 0.0
        self._retention_at = float("-inf")
        self._disk_at = float("-inf")

    async def run(self) -> None:
        """Record, for ever."""
        tasks = [
            asyncio.create_task(work)
            for work in (self.channel.run(), self._flush(), self._step_often())
        ]
        try:
            await asyncio.gather(*tasks)
        finally:
            await end_tasks(tasks)

    async def close(self) -> None:
        """End all recordings; the recorder stops."""
        for recording_id in list(self._open):
            self._end(recording_id, "recorder_stopped")
        for robot in self._robots.values():
            await robot.close()
        await end_tasks(self.repairs)
        await self._store.flush()

    async def _flush(self) -> None:
        while True:
            await asyncio.sleep(FLUSH_EVERY_S)
            for robot in self._robots.values():
                robot.flush()

    async def _step_often(self) -> None:
        while True:
            try:
                await self.step()
            except Exception:
                log.exception("a step of the recorder failed")
            await asyncio.sleep(STEP_S)

    async def step(self) -> None:
        """Begin and end what is to begin and to end now."""
        self._measure()
        self._end_failed()
        answer = await self._store.read()
        if answer is None:
            return
        rows, robots = answer
        # The database has the ends of all others.
        self._ended &= {row.id for row in rows}
        self._leave_lost(rows)
        recordable = {robot.id: robot for robot in robots}
        asked_ids = {row.robot_id for row in rows if row.ended_at is None and row.cause == "asked"}
        await self._drop_unneeded(recordable, asked_ids)
        for row in rows:
            await self._handle(row, recordable.get(row.robot_id))
        for robot in robots:
            await self._by_settings(robot)
        keeping = [recorder for recorder in self._robots.values() if recorder.keeps_recent]
        for recorder in keeping:
            recorder.share_memory(len(keeping))
        await self._follow()
        await self._write_progress()
        await self._check_room()
        await self._delete_old()

    def _measure(self) -> None:
        now = time.monotonic()
        if now - self._measured_at >= MEASURE_EVERY_S:
            self._measured_at = now
            self._bytes = used_bytes(self._folder) + self._bytes_elsewhere
            if self._bytes >= self._settings.max_bytes:
                self._full = "quota_reached"
            else:
                self._full = "disk_full" if self._is_disk_low else None

    def _leave_lost(self, rows: Sequence[RecordingRow]) -> None:
        """End what the database no longer knows: a standby without the newest records, whose numbers come again."""
        robot_ids = {row.id: row.robot_id for row in rows}
        for number, (recorder, _, _) in list(self._open.items()):
            if robot_ids.get(number) != recorder.robot.id:
                del self._open[number]
                recorder.end(number)
                log.warning("recording %d ends: the database does not know it", number)

    async def _handle(self, row: RecordingRow, robot: RecordableRobot | None) -> None:
        if row.id in self._open:
            self._check_open(row)
        elif row.is_delete_requested and (row.started_at is None or row.ended_at is not None):
            await self._delete(row.id)
        elif row.is_cell_removed or (row.started_at is not None and row.ended_at is None):
            if row.id not in self._ended:
                self._ended.add(row.id)
                task = asyncio.create_task(self._end_former(row))
                self.repairs.add(task)
                task.add_done_callback(self.repairs.discard)
        elif row.started_at is None and row.id not in self._ended:
            await self._begin_asked(row, robot)

    def _check_open(self, row: RecordingRow) -> None:
        if row.is_stop_requested or row.is_delete_requested:
            self._end(row.id, "stopped")
        elif not row.may_go_on:
            self._end(row.id, "right_ended")

    async def _begin_asked(self, row: RecordingRow, robot: RecordableRobot | None) -> None:
        code = self._why_not(row, robot)
        if code is None and robot is not None:
            recorder = self._ensure(robot)
            # A robot of another cell is that one's recorder's.
            await self.channel.follow(robot.id, writes=recorder.is_collecting)
            is_here = recorder.state.online and recorder.state.is_heard
            if is_here and await self._store.begin(row, robot):
                actor = row.asked_by or RECORDER.name
                self._begin(row.id, recorder, "asked", actor, asked_s=row.asked_s)
            return
        self._note_end(row.id, row.robot, row.asked_by, code or "robot_gone")

    def _why_not(self, row: RecordingRow, robot: RecordableRobot | None) -> str | None:
        """Return the code of why a recording does not begin; None: it may."""
        if robot is None:
            return "robot_gone"
        if row.is_stop_requested:
            return "stopped"
        if not row.may_go_on:
            return "right_ended"
        if row.is_late:
            return "robot_offline" if self.channel.is_open else "recorder_away"
        return self._full

    async def _by_settings(self, robot: RecordableRobot) -> None:
        when = robot.recording_when
        cause = next((each for each in WHENS if each == when), None)
        recorder = self._robots.get(robot.id)
        if cause is None:
            self._end_all(robot.id, lambda cause: cause != "asked", "setting_changed")
            if recorder is not None:
                recorder.keep_recent(False)
            return
        recorder = recorder or self._ensure(robot)
        self._end_all(robot.id, lambda other: other not in {"asked", cause}, "setting_changed")
        # Of a robot at another cell nothing comes.
        recorder.keep_recent(cause == "on_stop" and bool(recorder.state.online))
        number = next(
            (
                number
                for number, (owner, its_cause, _) in self._open.items()
                if owner is recorder and its_cause == cause
            ),
            None,
        )
        code = self._end_code(cause, recorder.state)
        if number is not None:
            if code is not None:
                self._end(number, code)
        elif (
            code is None
            and self._full is None
            and recorder.state.is_heard
            and time.monotonic() >= self._paused_until
        ):
            await self._begin_by_settings(robot, recorder, cause)

    async def _begin_by_settings(
        self, robot: RecordableRobot, recorder: RobotRecorder, cause: RecordingCause
    ) -> None:
        before_s = BEFORE_STOP_S if cause == "on_stop" else 0.0
        number = await self._store.add(robot, cause, utc_now() - dt.timedelta(seconds=before_s))
        if number is not None:
            self._begin(number, recorder, cause, RECORDER.name)

    def _end_code(self, cause: RecordingCause, state: RobotState) -> str | None:
        """Return the code of why a robot is not to be recorded now by its settings; None: it is."""
        now = time.monotonic()
        if state.is_elsewhere:
            return "robot_moved"
        if state.online is None:
            return "robot_offline"
        if state.offline_since is not None and now - state.offline_since > OFFLINE_S:
            return "robot_offline" if state.is_heard else "relay_away"
        if cause == "always":
            return None
        if cause == "driven":
            since_s = None if state.driven_until is None else now - state.driven_until
            goes_on = bool(state.driver) or (since_s is not None and since_s <= DRIVE_GAP_S)
            return None if goes_on else "drive_ended"
        at = state.stopped_at
        return None if at is not None and now - at <= AFTER_STOP_S else "complete"

    def _begin(
        self,
        number: int,
        recorder: RobotRecorder,
        cause: RecordingCause,
        actor: str,
        *,
        asked_s: int = 0,
    ) -> None:
        try:
            recording = recorder.begin(number, with_recent=cause == "on_stop")
        except OSError as exc:
            log.warning("recording %d: cannot begin its file: %s", number, exc)
            self._paused_until = time.monotonic() + PAUSE_S
            self._note_end(number, recorder.robot.name, actor, "disk_full")
            return
        # A move to another cell does not make it longer.
        recording.began_at -= max(asked_s, 0)
        log.info("recording %d of robot %s begins", number, recorder.robot.name)
        self._open[number] = recorder, cause, actor

    def _end(self, number: int, code: str) -> None:
        recorder, _, actor = self._open.pop(number)
        recording = recorder.end(number)
        log.info("recording %d of robot %s ended: %s", number, recorder.robot.name, code)
        if code == "disk_full":
            self._paused_until = time.monotonic() + PAUSE_S
        self._note_end(number, recorder.robot.name, actor, code, progress=recording.progress())

    def _note_end(
        self,
        number: int,
        robot: str,
        actor: str | None,
        code: str,
        *,
        progress: Progress | None = None,
        ended_at: dt.datetime | None = None,
    ) -> None:
        self._ended.add(number)
        self._store.end(
            RecordingEnd(
                number, robot, actor or RECORDER.name, code, progress, ended_at or utc_now()
            )
        )

    def _end_all(self, robot_id: int, matches: Callable[[RecordingCause], bool], code: str) -> None:
        for number, (recorder, cause, _) in list(self._open.items()):
            if recorder.robot.id == robot_id and matches(cause):
                self._end(number, code)

    def _end_failed(self) -> None:
        """End what cannot be written, is too long, or would take more than there is room for."""
        now = time.monotonic()
        for number, (recorder, cause, _) in list(self._open.items()):
            recording = recorder.recordings[number]
            most_s = MAX_ASKED_S if cause == "asked" else MAX_PIECE_S
            code = "robot_moved" if recorder.state.is_elsewhere else recording.failure or self._full
            if code is None and now - recording.began_at > most_s:
                code = "too_long"
            if code is not None:
                self._end(number, code)

    async def _end_former(self, row: RecordingRow) -> None:
        """End a recording of the recorder before this one, whose file is made whole."""
        # If the file says no end: it was under way until its recorder last wrote of it, and perhaps somewhat later.
        path, ended_at, progress = path_of(self._folder, row.id), row.progress_at, None
        try:
            index = await asyncio.to_thread(repair, path)
            if index is not None:
                if index.end_ns:
                    ended_at = dt.datetime.fromtimestamp(index.end_ns / NS_PER_S, dt.UTC)
                size, messages = path.stat().st_size, index.counts.total()
                progress = Progress(size, messages, None, None, None)
        except OSError as exc:
            log.warning("recording %d: cannot make its file whole: %s", row.id, exc)
        self._note_end(
            row.id,
            row.robot,
            row.asked_by,
            "recorder_restarted",
            progress=progress,
            ended_at=max(filter(None, (row.started_at, ended_at)), default=None),
        )

    async def _drop_unneeded(
        self, recordable: Mapping[int, RecordableRobot], asked_ids: Collection[int]
    ) -> None:
        for robot_id in self._robots.keys() - recordable.keys():
            self._end_all(robot_id, lambda _cause: True, "robot_gone")
        for robot_id, recorder in list(self._robots.items()):
            robot = recordable.get(robot_id)
            if robot is not None and robot.name != recorder.robot.name:
                self._end_all(robot_id, lambda _cause: True, "robot_renamed")
            is_needed = robot is not None and (
                recorder.is_collecting or robot.recording_when in WHENS or robot_id in asked_ids
            )
            if not is_needed or robot is None or robot.name != recorder.robot.name:
                await self._drop(robot_id)
            else:
                recorder.update(robot)

    async def _drop(self, robot_id: int) -> None:
        recorder = self._robots.pop(robot_id)
        await recorder.close()
        await self.channel.leave(robot_id)

    def _ensure(self, robot: RecordableRobot) -> RobotRecorder:
        recorder = self._robots.get(robot.id)
        if recorder is None:
            recorder = RobotRecorder(self._client, robot, self._folder)
            self._robots[robot.id] = recorder
        return recorder

    async def _follow(self) -> None:
        for robot_id, recorder in list(self._robots.items()):
            await self.channel.follow(robot_id, writes=recorder.is_collecting)

    def on_event(self, robot_id: int, topic: str, message: Mapping[str, Any]) -> None:
        """The relay sent what it knows of a robot."""
        recorder = self._robots.get(robot_id)
        if recorder is not None:
            recorder.on_event(topic, message)

    def on_lost(self, heard_ns: int) -> None:
        """The relay is lost, or something of what it sent, after this time."""
        for recorder in self._robots.values():
            recorder.on_lost(heard_ns)

    async def _write_progress(self) -> None:
        now = time.monotonic()
        if now - self._progress_at < PROGRESS_EVERY_S:
            return
        self._progress_at = now
        await self._store.write_progress(
            {
                number: recorder.recordings[number].progress()
                for number, (recorder, _, _) in self._open.items()
            }
        )

    async def _check_room(self) -> None:
        now = time.monotonic()
        if now - self._disk_at < DISK_EVERY_S:
            return
        self._disk_at = now
        self._bytes_elsewhere = await self._store.read_bytes_elsewhere(self._bytes_elsewhere)
        try:
            space = await asyncio.to_thread(read_space, self._folder)
        except OSError as exc:
            log.warning("cannot see how full %s is: %s", self._folder, exc)
        else:
            least = min(space.size * MIN_FREE_PART, MAX_MIN_FREE_BYTES)
            self._is_disk_low = space.free < least
            quota_left = max(1 - self._bytes / self._settings.max_bytes, 0.0)
            # A disk that took no file has no room, whatever it says.
            is_writable = now >= self._paused_until
            await self._store.write_room(min(space.free_part, quota_left) if is_writable else 0.0)

    async def _delete_old(self) -> None:
        now = time.monotonic()
        if now - self._retention_at < RETENTION_EVERY_S:
            return
        self._retention_at = now
        await self._set_lost_aside()
        if not self._settings.days:
            return
        oldest = utc_now() - dt.timedelta(days=self._settings.days)
        for number in await self._store.read_older(oldest):
            await self._delete(number)
        for path in self._folder.glob("*-*.mcap"):
            if path.stat().st_mtime < oldest.timestamp():
                path.unlink(missing_ok=True)
                log.info("file %s of no recording is deleted", path.name)

    async def _set_lost_aside(self) -> None:
        """Rename files that the database does not know since a backup was put back.

        Another cell may get their numbers for its recordings, and web sends the file of a number.
        """
        stems = [path.stem for path in self._folder.glob("*.mcap")]
        numbers = {int(stem) for stem in stems if stem.isdecimal()}
        present = await self._store.read_present(numbers)
        for number in numbers - (numbers if present is None else present):
            set_aside(path_of(self._folder, number))

    async def _delete(self, number: int) -> None:
        try:
            path_of(self._folder, number).unlink(missing_ok=True)
        except OSError as exc:
            # It is tried again; what else is to begin and to end must not wait for that.
            log.warning("recording %d: cannot delete its file: %s", number, exc)
            return
        log.info("recording %d is deleted", number)
        await self._store.note_deleted(number)


def used_bytes(folder: Path) -> int:
    """Return the size of all recordings."""
    return sum(path.stat().st_size for path in folder.glob("*.mcap"))

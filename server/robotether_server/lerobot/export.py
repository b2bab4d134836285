"""Makes one LeRobot dataset of some recordings: reads them twice, first to pair, then to write.

The first time says which frames can be decoded, and how large they are; nothing of an image is kept.
"""

from __future__ import annotations

import math
import re
import shutil
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from av.video.frame import VideoFrame
from robotether_common.own_topics import own_topic

from robotether_server.contract.recordings import NS_PER_S
from robotether_server.lerobot.actions import action_names, are_float32
from robotether_server.lerobot.dataset import DatasetLayout, DatasetWriter
from robotether_server.lerobot.decoding import CameraDecoder
from robotether_server.lerobot.pairing import (
    MIN_EPISODE_S,
    CutReason,
    DriveData,
    EpisodeStep,
    FrameInfo,
    episodes,
    frame_rate,
    seen_cameras,
    steps,
)
from robotether_server.lerobot.recording import (
    MAX_MESSAGES,
    STATE_NAMES,
    USUAL_TOPICS,
    NotExportedError,
    Recorded,
    RecordedCommand,
    RecordedControl,
    RecordedFrame,
    RecordedState,
    read_recording,
)

# Maximum number of cameras that are decoded at once.
MAX_CAMERAS = 8
# Maximum length of a recording that is exported; a longer one has a clock that jumped.
MAX_DAYS = 1
# Maximum difference of two shapes of one camera: an encoder that makes frames smaller rounds their sides.
MAX_SHAPE_DIFFERENCE = 0.02
MAX_NAME = 64
NOT_IN_NAMES = re.compile(r"[^A-Za-z0-9_]+")


@dataclass(frozen=True)
class ExportOptions:
    """What the person asked for; `fps` None: the cameras' own, no `cameras`: those that the driver saw.

    `odometry`: its topic; None: that of the robot's namespace.
    """

    fps: int | None
    cameras: Sequence[str]
    task: str
    odometry: str | None = None


@dataclass
class ExportReport:
    """What became of the recordings: steps in episodes, in those that are too short, and cut ones by their reason."""

    fps: int
    cameras: Sequence[str]
    episodes: int = 0
    steps: int = 0
    short_episodes: int = 0
    short_steps: int = 0
    cut: Counter[CutReason] = field(default_factory=Counter)


@dataclass(frozen=True)
class _Recording:
    """One recording, and its episodes."""

    path: Path
    drive: DriveData
    episodes: list[list[EpisodeStep]] = field(default_factory=list)


def export(paths: Sequence[Path], folder: Path, options: ExportOptions) -> ExportReport:
    """Write a dataset into a new folder; raise NotExportedError, and leave no folder then."""
    if folder.exists():
        raise NotExportedError(f"cannot export to {folder}: it exists; name a new folder")
    recordings = [_Recording(path, read_drive(path, options.cameras)) for path in paths]
    cameras = _choose_cameras(recordings, options.cameras)
    state_kind = _choose_states(recordings, options.odometry)
    command_kind = _command_kind(recordings)
    fps = options.fps or frame_rate([recording.drive for recording in recordings], cameras)
    report = ExportReport(fps, cameras)
    for recording in recordings:
        _find_episodes(recording, command_kind, report)
    if not report.episodes:
        raise NotExportedError(f"cannot export: no episode is left; {describe_cuts(report)}")
    layout = DatasetLayout(
        fps=fps,
        task=options.task,
        cameras=_sizes(recordings, cameras),
        state_names=STATE_NAMES[state_kind],
        action_names=action_names(command_kind),
    )
    _write(recordings, folder, layout, cameras)
    return report


def describe_cuts(report: ExportReport) -> str:
    """Return how much is in no episode, and why."""
    counts = {cut.value: count for cut, count in report.cut.most_common()}
    if report.short_steps:
        counts[f"{report.short_episodes} stretches shorter than {MIN_EPISODE_S:g} s"] = (
            report.short_steps
        )
    return "; ".join(f"{count / report.fps:.1f} s: {why}" for why, count in counts.items())


def read_drive(path: Path, cameras: Sequence[str]) -> DriveData:
    """Read a recording, with the frames of these cameras, or of all; raise NotExportedError."""
    drive = DriveData()
    lists: dict[type, list[Any]] = {
        RecordedCommand: drive.commands,
        RecordedControl: drive.controls,
        RecordedState: drive.states,
    }
    decoders: dict[str, CameraDecoder] = {}
    newest_ns: dict[type, int] = {}
    for count, record in enumerate(read_recording(path)):
        if count >= MAX_MESSAGES:
            raise NotExportedError(f"cannot export {path}: it has over {MAX_MESSAGES} messages")
        _note_time(drive, newest_ns, record)
        if not isinstance(record, RecordedFrame):
            lists[type(record)].append(record)
        elif not cameras or record.camera in cameras:
            decoder = decoders.setdefault(record.camera, CameraDecoder())
            frame = FrameInfo(record.sequence, record.taken_ns, record.log_ns, 0, 0)
            drive.frames.setdefault(record.camera, []).append(frame)
            _note_sizes(drive.frames[record.camera], decoder.decode(record))
        if len(decoders) > MAX_CAMERAS:
            raise NotExportedError(
                f"cannot export {path}: it has over {MAX_CAMERAS} cameras; choose some with --camera"
            )
    for camera, decoder in decoders.items():
        _note_sizes(drive.frames[camera], decoder.flush())
    drive.commands.sort(key=lambda command: command.at_ns)
    if drive.commands:
        days = (drive.commands[-1].at_ns - drive.commands[0].at_ns) / NS_PER_S / 86_400
        if days > MAX_DAYS:
            raise NotExportedError(
                f"cannot export {path}: the server's clock jumped by {days:.0f} days in it"
            )
    return drive


def _note_time(drive: DriveData, newest_ns: dict[type, int], record: Recorded) -> None:
    """Note the span that begins with a record which is older than those of its type before it."""
    at_ns = record.log_ns if isinstance(record, RecordedFrame) else record.at_ns
    newest = newest_ns.get(type(record), at_ns)
    start, end = drive.repeated_ns[-1] if drive.repeated_ns else (newest, newest)
    if at_ns < newest and not start <= at_ns < newest <= end:
        drive.repeated_ns.append((at_ns, newest))
    newest_ns[type(record)] = max(at_ns, newest)


def _note_sizes(frames: list[FrameInfo], decoded: Iterable[tuple[int, VideoFrame]]) -> None:
    for place, image in decoded:
        frames[place] = frames[place]._replace(width=image.width, height=image.height)


def _choose_cameras(recordings: Sequence[_Recording], chosen: Sequence[str]) -> list[str]:
    """Return the cameras that the driver of each recording saw; in each they must be the same."""
    cameras = sorted(set(chosen)) or seen_cameras(recordings[0].drive)
    for recording in recordings:
        seen = seen_cameras(recording.drive)
        if not seen or not set(cameras) <= set(seen) or not (chosen or set(seen) == set(cameras)):
            raise NotExportedError(
                f"cannot export {recording.path}: its driver saw {', '.join(seen) or 'no recorded camera'}"
                f"{', not ' + ', '.join(cameras) if seen else ''}; choose with --camera what all saw"
            )
    names = Counter(map(_name_of, cameras))
    if len(names) < len(cameras):
        raise NotExportedError(
            "cannot export: two cameras have the same name except for punctuation"
        )
    return cameras


def _choose_states(recordings: Sequence[_Recording], named: str | None) -> str:
    """Keep the states of one odometry of each recording, of a type that all have, and return the type."""
    for kind in STATE_NAMES:
        topics = [_odometry_of(recording, kind, named) for recording in recordings]
        if None in topics:
            continue
        for recording, topic in zip(recordings, topics, strict=True):
            recording.drive.states[:] = [
                state
                for state in recording.drive.states
                if (state.kind, state.topic) == (kind, topic) and are_float32(state.values)
            ]
        return kind
    kinds = " or ".join(kind.replace("/msg/", "/") for kind in STATE_NAMES)
    raise NotExportedError(f"cannot export: not all recordings have the robot's state ({kinds})")


def _odometry_of(recording: _Recording, kind: str, named: str | None) -> str | None:
    """Return the topic of the odometry of a type; None: there is none. Raise NotExportedError where it is in doubt."""
    topics = {state.topic for state in recording.drive.states if state.kind == kind}
    if named is not None or not topics:
        return named if named in topics else None
    # Another robot's may be on the same ROS graph.
    drive_topic = next((command.topic for command in recording.drive.commands), "")
    own = own_topic(dict.fromkeys(topics, kind), kind, USUAL_TOPICS[kind], drive_topic)
    if own is None:
        raise NotExportedError(
            f"cannot export {recording.path}: it has the odometries {', '.join(sorted(topics))}; "
            "choose one with --odometry"
        )
    return own


def _command_kind(recordings: Sequence[_Recording]) -> str:
    kinds = {
        command.action.kind
        for recording in recordings
        for command in recording.drive.commands
        if command.is_sent and command.action is not None
    }
    if len(kinds) != 1:
        named = " and ".join(sorted(kinds)) or "no drive command that can be read"
        raise NotExportedError(f"cannot export: the recordings have {named}; one kind is needed")
    return kinds.pop()


def _find_episodes(recording: _Recording, command_kind: str, report: ExportReport) -> None:
    def counted() -> Iterator[EpisodeStep | CutReason]:
        for step in steps(recording.drive, report.cameras, command_kind, report.fps):
            if isinstance(step, CutReason):
                report.cut[step] += 1
            yield step

    for episode in episodes(counted(), report.fps):
        if len(episode) < MIN_EPISODE_S * report.fps:
            report.short_episodes += 1
            report.short_steps += len(episode)
            continue
        recording.episodes.append(episode)
        report.episodes += 1
        report.steps += len(episode)


def _sizes(recordings: Sequence[_Recording], cameras: Sequence[str]) -> dict[str, tuple[int, int]]:
    """Return width and height of each camera's videos: those of its largest frame, as even numbers."""
    sizes = {}
    for number, camera in enumerate(cameras):
        shapes = {
            (frame.width, frame.height)
            for recording in recordings
            for place in {step.frames[number] for each in recording.episodes for step in each}
            for frame in [recording.drive.frames[camera][place]]
        }
        width, height = max(shapes, key=math.prod)
        for other_width, other_height in shapes:
            difference = other_width / other_height * height / width - 1
            if abs(difference) > MAX_SHAPE_DIFFERENCE:
                raise NotExportedError(
                    f"cannot export: {camera} has frames of {width}x{height} and of {other_width}x{other_height}"
                )
        sizes[_name_of(camera)] = width // 2 * 2, height // 2 * 2
    return sizes


def _name_of(camera: str) -> str:
    """Return a camera's name in features and paths."""
    return NOT_IN_NAMES.sub("_", camera.strip("/"))[:MAX_NAME] or "_"


def _write(
    recordings: Sequence[_Recording], folder: Path, layout: DatasetLayout, cameras: Sequence[str]
) -> None:
    keys = dict(zip(cameras, layout.video_keys(), strict=True))
    try:
        folder.mkdir(parents=True)
        writer = DatasetWriter(folder, layout)
        try:
            for recording in recordings:
                _write_recording(recording, writer, keys)
            writer.finish()
        finally:
            writer.close()
    except BaseException as exc:
        shutil.rmtree(folder, ignore_errors=True)
        if isinstance(exc, OSError):
            raise NotExportedError(f"cannot export to {folder}: {exc.strerror or exc}") from exc
        raise


def _write_recording(recording: _Recording, writer: DatasetWriter, keys: Mapping[str, str]) -> None:
    # By camera and place of a frame: the episodes that have it, and for how many steps.
    needed_places: dict[tuple[str, int], Counter[int]] = {}
    for episode in recording.episodes:
        number = writer.add_episode(episode)
        for step in episode:
            for camera, place in zip(keys, step.frames, strict=True):
                needed_places.setdefault((camera, place), Counter())[number] += 1
    for camera, place, image in _images(recording.path, keys):
        for number, times in needed_places.pop((camera, place), {}).items():
            writer.add_image(number, keys[camera], image, times)
    if needed_places:
        raise NotExportedError(f"cannot export {recording.path}: the file changed meanwhile")


def _images(path: Path, cameras: Iterable[str]) -> Iterator[tuple[str, int, VideoFrame]]:
    """Yield the frames of these cameras with their places."""
    decoders = {camera: CameraDecoder() for camera in cameras}
    for record in read_recording(path):
        if isinstance(record, RecordedFrame) and record.camera in decoders:
            for place, image in decoders[record.camera].decode(record):
                yield record.camera, place, image
    for camera, decoder in decoders.items():
        for place, image in decoder.flush():
            yield camera, place, image

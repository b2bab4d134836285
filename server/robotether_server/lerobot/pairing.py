"""Pairs each step of a dataset with what its driver had seen by then, the command in force, and the robot's state.

What cannot be known is cut, never guessed. Pure. Times in ns are the server's Unix time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from itertools import pairwise
from statistics import median
from typing import NamedTuple

from robotether_server.contract.recordings import NS_PER_S
from robotether_server.lerobot.actions import KINDS
from robotether_server.lerobot.recording import RecordedCommand, RecordedControl, RecordedState

# Maximum age of what the driver saw, and of the state: beyond it the video was frozen, or the robot silent.
MAX_AGE_S = 1.0
# Time for which a command is in force; the guard stops the robot then.
COMMAND_S = 0.5
# Time within which a frame is named by a command after it was recorded; a number can come again later.
MAX_NAMED_S = 10.0
# Maximum delay of the recorder: a frame may be recorded after the command that names it, or be taken by a clock ahead.
MAX_DELAY_S = 0.5
MIN_EPISODE_S = 1.0
# Maximum length of an episode: its timestamps are float32, which are exact to 1e-4 s only up to 1700 s.
MAX_EPISODE_S = 1000.0
FPS = (1, 60)


class FrameInfo(NamedTuple):
    """A frame that was recorded. Sizes in pixels, 0 of one that cannot be decoded."""

    sequence: int
    taken_ns: int
    log_ns: int
    width: int
    height: int


@dataclass
class DriveData:
    """What one recording has, each list in the order of its times; frames by camera.

    `repeated_ns`: spans of time that are there twice, as the server's clock was set back.
    """

    frames: dict[str, list[FrameInfo]] = field(default_factory=dict)
    commands: list[RecordedCommand] = field(default_factory=list)
    controls: list[RecordedControl] = field(default_factory=list)
    states: list[RecordedState] = field(default_factory=list)
    repeated_ns: list[tuple[int, int]] = field(default_factory=list)

    def is_repeated(self, at_ns: int) -> bool:
        """Whether what is recorded of a time, or counts then, may be of another."""
        margin_ns = int(MAX_AGE_S * NS_PER_S)
        return any(start <= at_ns <= end + margin_ns for start, end in self.repeated_ns)


class CutReason(Enum):
    """Why a time is in no episode."""

    NOT_DRIVEN = "nobody drove"
    UNKNOWN_DRIVER = (
        "who drove is not known: the recorder had lost the relay, or the relay the robot"
    )
    UNKNOWN_FRAME = "which frame the driver had seen is not known, or it is not recorded"
    FROZEN = f"what the driver had seen was older than {MAX_AGE_S:g} s"
    NO_STATE = f"no odometry for {MAX_AGE_S:g} s"
    UNKNOWN_COMMAND = "the command cannot be read"
    REPEATED_TIME = "the server's clock was set back, so these times are there twice"


class EpisodeStep(NamedTuple):
    """One row of a dataset. `frames` and `ages_s` in the order of the cameras."""

    fence: int
    frames: tuple[int, ...]
    ages_s: tuple[float, ...]
    state: tuple[float, ...]
    action: tuple[float, ...]


def frame_rate(drives: Iterable[DriveData], cameras: Iterable[str]) -> int:
    """Return the median rate in Hz of the quickest camera, from 1 to 60."""
    intervals: dict[str, list[int]] = {camera: [] for camera in cameras}
    for drive in drives:
        for camera, lengths in intervals.items():
            times = [frame.taken_ns for frame in drive.frames.get(camera, ())]
            lengths += [after - before for before, after in pairwise(times) if after > before]
    rates = [NS_PER_S / median(lengths) for lengths in intervals.values() if lengths]
    least, most = FPS
    return round(min(max(max(rates, default=least), least), most))


def seen_cameras(drive: DriveData) -> list[str]:
    """Return the recorded cameras of which the driver saw a frame."""
    named = {
        camera for command in drive.commands for camera, sequence in command.seen if sequence >= 0
    }
    return sorted(named & drive.frames.keys())


def steps(
    drive: DriveData, cameras: Sequence[str], kind: str, fps: int
) -> Iterator[EpisodeStep | CutReason]:
    """Yield what is the case each 1/fps, from the first command to the last; commands are of one kind."""
    situation = _Situation(drive, cameras, kind)
    events: list[RecordedCommand | RecordedControl | RecordedState] = [
        *drive.controls,
        *drive.commands,
        *drive.states,
    ]
    events.sort(key=lambda event: event.at_ns)
    start_ns = drive.commands[0].at_ns
    count = (drive.commands[-1].at_ns - start_ns) * fps // NS_PER_S + 1
    passed = 0
    for number in range(count):
        at_ns = start_ns + round(number * NS_PER_S / fps)
        while passed < len(events) and events[passed].at_ns <= at_ns:
            situation.update(events[passed])
            passed += 1
        yield CutReason.REPEATED_TIME if drive.is_repeated(at_ns) else situation.step(at_ns)


def episodes(timeline: Iterable[EpisodeStep | CutReason], fps: int) -> Iterator[list[EpisodeStep]]:
    """Yield the stretches without a cut, each of one driver, those that are too short included."""
    episode: list[EpisodeStep] = []
    for step in timeline:
        goes_on = isinstance(step, EpisodeStep) and (not episode or step.fence == episode[0].fence)
        if episode and (not goes_on or len(episode) >= MAX_EPISODE_S * fps):
            yield episode
            episode = []
        if isinstance(step, EpisodeStep):
            episode.append(step)
    if episode:
        yield episode


class _Situation:
    """What is known at a time."""

    def __init__(self, drive: DriveData, cameras: Sequence[str], kind: str) -> None:
        self._zero = (0.0,) * len(KINDS[kind])
        self._frames = {camera: drive.frames[camera] for camera in cameras}
        self._numbers = {camera: _by_number(frames) for camera, frames in self._frames.items()}
        self._control: RecordedControl | None = None
        self._state: RecordedState | None = None
        self._fence = 0
        # Of the one who drives: the newest command that was sent, and by camera the place of the newest frame that they
        # had seen, None for unknown.
        self._command: RecordedCommand | None = None
        self._seen: dict[str, int | None] = {}

    def update(self, event: RecordedCommand | RecordedControl | RecordedState) -> None:
        """Take over what happened next."""
        if isinstance(event, RecordedState):
            self._state = event
            return
        if event.fence > self._fence:
            self._fence, self._command, self._seen = event.fence, None, {}
        if isinstance(event, RecordedControl):
            self._control = event
        elif event.fence == self._fence:
            self._see(event)
            if event.is_sent:
                self._command = event

    def _see(self, command: RecordedCommand) -> None:
        for camera, sequence in command.seen:
            if camera not in self._frames:
                continue
            place = self._place(camera, sequence, command.at_ns)
            before = self._seen.get(camera)
            self._seen[camera] = place if place is None or before is None else max(place, before)

    def _place(self, camera: str, sequence: int, at_ns: int) -> int | None:
        """Return which frame a command names; None where it is not recorded, or more than one has its number."""
        frames = self._frames[camera]
        near = [
            place
            for place in self._numbers[camera].get(sequence, ())
            if -MAX_DELAY_S * NS_PER_S <= at_ns - frames[place].log_ns <= MAX_NAMED_S * NS_PER_S
        ]
        return near[0] if len(near) == 1 else None

    def step(self, at_ns: int) -> EpisodeStep | CutReason:
        """Return the step of a time up to which all was taken over."""
        control, state = self._control, self._state
        if control is None or control.fence < 0:
            return CutReason.UNKNOWN_DRIVER
        if not control.is_driven:
            return CutReason.NOT_DRIVEN
        views = [self._view(camera, at_ns) for camera in self._frames]
        places, ages_s = [], []
        for view in views:
            if isinstance(view, CutReason):
                return view
            places.append(view[0])
            ages_s.append(view[1])
        if state is None or at_ns - state.at_ns > MAX_AGE_S * NS_PER_S:
            return CutReason.NO_STATE
        action = self._action(at_ns, control)
        if action is None:
            return CutReason.UNKNOWN_COMMAND
        return EpisodeStep(self._fence, tuple(places), tuple(ages_s), state.values, action)

    def _view(self, camera: str, at_ns: int) -> tuple[int, float] | CutReason:
        """Return which frame of a camera the driver had seen, and its age in seconds."""
        place = self._seen.get(camera)
        if place is None:
            return CutReason.UNKNOWN_FRAME
        frame = self._frames[camera][place]
        if not frame.width or frame.taken_ns - frame.log_ns > MAX_DELAY_S * NS_PER_S:
            return CutReason.UNKNOWN_FRAME
        age_s = max(0, at_ns - min(frame.taken_ns, frame.log_ns)) / NS_PER_S
        return (place, age_s) if age_s <= MAX_AGE_S else CutReason.FROZEN

    def _action(self, at_ns: int, control: RecordedControl) -> tuple[float, ...] | None:
        """Return the command in force; zero where there is none, as the guard makes the robot stand."""
        command = self._command
        if command is None or control.is_stopped:
            return self._zero
        if at_ns - command.at_ns > COMMAND_S * NS_PER_S:
            return self._zero
        return None if command.action is None else command.action.values


def _by_number(frames: Sequence[FrameInfo]) -> Mapping[int, list[int]]:
    places: dict[int, list[int]] = {}
    for place, frame in enumerate(frames):
        places.setdefault(frame.sequence, []).append(place)
    return places

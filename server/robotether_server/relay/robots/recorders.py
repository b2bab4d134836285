"""Who records a robot, and what only the relay knows of a drive, which recorders get as it happens.

A `Robot` has one `Recorders`; drive connections and `channels/recorder` report to it. It needs no recorder.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from robotether_server.contract.recordings import ros_time

log = logging.getLogger(__name__)

RecordedTopic = Literal["commands", "round_trips", "seen_ages", "control"]
# What became of a drive command.
Outcome = Literal["sent", "too_old", "ahead", "replaced", "clock_unknown"]


def stamped(members: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the message of an event of now."""
    return {"stamp": ros_time(time.time_ns()), **members}


@dataclass(eq=False)
class RecorderOfRobot:
    """One recorder of one robot; `send` must not wait. `writes`: what it gets goes into a file."""

    send: Callable[[RecordedTopic, Mapping[str, Any]], None]
    writes: bool = False


class Recorders:
    """All recorders of one robot."""

    def __init__(self) -> None:
        self._recorders: set[RecorderOfRobot] = set()

    def __bool__(self) -> bool:
        return bool(self._recorders)

    @property
    def write(self) -> bool:
        """Whether somebody writes what happens into a file."""
        return any(recorder.writes for recorder in self._recorders)

    def add(self, recorder: RecorderOfRobot) -> None:
        """Send it what happens from now on."""
        self._recorders.add(recorder)

    def remove(self, recorder: RecorderOfRobot) -> None:
        """Send it nothing more."""
        self._recorders.discard(recorder)

    def send(self, topic: RecordedTopic, make: Callable[[], Mapping[str, Any]]) -> None:
        """Send an event of now, whose members `make` returns, to all recorders; it never raises."""
        if not self._recorders:
            return
        try:
            message = stamped(make())
            for recorder in self._recorders:
                recorder.send(topic, message)
        except Exception:
            # A defect of recording must not end a drive.
            log.exception("an event cannot be recorded")

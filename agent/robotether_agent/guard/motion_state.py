"""Records in a file (motion.json) that the robot moves, so that the next guard can stop it.

Used by the drive controller alone. The file is in the run directory and outlives a crash, so that the next guard zeroes
what this one left: what it says of a topic must be what the next guard needs for that.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Container, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import cast

from robotether_common.ros import NAME, full_name

from robotether_agent.fields import (
    FieldError,
    JsonObject,
    as_object,
    get_match,
    get_text,
    parse_object,
)
from robotether_agent.files import read_text
from robotether_agent.guard.commands import MAX_FRAME_ID_LENGTH, SHAPES, Shape
from robotether_agent.problems import StateUnusable

MOTION_FILE = "motion.json"
# A driver's clean stop is often followed by the next motion; the mark need not be written for each.
REMOVED_AFTER_S = 1.0

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Driven:
    """A drive topic as it was driven; `type` as it was advertised, or empty."""

    topic: str
    shape: Shape
    type: str = ""
    frame_id: str = ""


class MotionFile:
    """The mark of a robot that may move."""

    def __init__(self, run_dir: Path) -> None:
        self._path = run_dir / MOTION_FILE

    def read(self) -> list[Driven] | None:
        """Return what was driven when the last guard ended: None nothing, an empty list something unknown."""
        try:
            text = read_text(self._path)
            return None if text is None else _driven(parse_object(text, MOTION_FILE))
        except (StateUnusable, FieldError) as error:
            log.warning("%s cannot be read: %s", self._path, error)
            return []

    def write(self, driven: Sequence[Driven]) -> None:
        """Mark these topics; StateUnusable when that fails."""
        text = json.dumps({"topics": [asdict(topic) for topic in driven]}) + "\n"
        # Not synced to the disk, which would hold the first command up: it must outlive the process only.
        new = self._path.with_suffix(".new")
        try:
            new.write_text(text, encoding="utf-8")
            new.replace(self._path)
        except OSError as error:
            raise StateUnusable(f"cannot write {self._path}: {error.strerror}") from error

    def remove(self) -> None:
        """Take the mark away; StateUnusable when that fails."""
        try:
            self._path.unlink(missing_ok=True)
        except OSError as error:
            raise StateUnusable(f"cannot remove {self._path}: {error.strerror}") from error


def _driven(file: JsonObject) -> list[Driven]:
    topics = file.get("topics")
    if not isinstance(topics, list):
        raise FieldError("field topics must be a list")
    return [_topic(as_object(topic, "a topic")) for topic in topics]


def _topic(fields: JsonObject) -> Driven:
    shape, type_name = get_text(fields, "shape"), get_text(fields, "type")
    if shape not in SHAPES.values() or (type_name and type_name not in SHAPES):
        raise FieldError(f"{shape!r} or {type_name!r} is no drive type")
    name = full_name(get_match(fields, "topic", NAME, "a topic's name"))
    if name is None:
        raise FieldError("field topic is too long")
    frame_id = get_text(fields, "frame_id", default="", limit=MAX_FRAME_ID_LENGTH)
    return Driven(name, cast("Shape", shape), type_name, frame_id)


class MotionTracker:
    """The mark of one drive controller."""

    def __init__(self, file: MotionFile) -> None:
        self._file = file
        # What stands in the file.
        self._recorded: dict[str, Driven] = {}
        self._remove_at = 0.0

    @property
    def ends_at(self) -> float | None:
        """When the mark of a robot that stands is taken away; None: there is none."""
        return self._remove_at if self._recorded else None

    def read_previous(self) -> list[Driven] | None:
        """Return what the last guard left: None nothing, an empty list something unknown."""
        return self._file.read()

    def adopt(self, driven: Iterable[Driven]) -> None:
        """Keep what the last guard left as this one's own."""
        self._recorded = {one.topic: one for one in driven}

    def ensure(self, moving: Driven, known: Container[str]) -> bool:
        """Write that a topic moves, before it does; False: it cannot. Others that are not `known` are left out."""
        if self._recorded.get(moving.topic) == moving:
            return True
        kept = {name: one for name, one in self._recorded.items() if name in known}
        recorded = {**kept, moving.topic: moving}
        try:
            self._file.write(list(recorded.values()))
        except StateUnusable as problem:
            log.error("%s", problem)  # noqa: TRY400 - no defect
            return False
        self._recorded = recorded
        return True

    def tend(self, now: float, *, moves: bool) -> None:
        """Take the mark away when the robot has stood for a while."""
        if moves or not self._recorded:
            self._remove_at = now + REMOVED_AFTER_S
        elif now >= self._remove_at:
            self.end(now)

    def end(self, now: float) -> None:
        """Take the mark away: the robot stands. Another guard's mark, which this one never took over, stays."""
        if not self._recorded:
            return
        try:
            self._file.remove()
            self._recorded = {}
        except StateUnusable as problem:
            log.warning("%s", problem)
            self._remove_at = now + REMOVED_AFTER_S

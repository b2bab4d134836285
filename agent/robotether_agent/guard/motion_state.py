"""The guard's two files, which outlive it: the stop (stop.json) and that the robot is in motion (motion.json).

The stop is in the state directory and outlives power; the motion is in the run directory and outlives a crash, so
that the next guard zeroes what this one left. A stop that cannot be read counts as a stop.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import cast

from robotether_agent.fields import (
    FieldError,
    JsonObject,
    as_object,
    get_match,
    get_text,
    parse_object,
)
from robotether_agent.files import read_text, write_atomic
from robotether_agent.guard.commands import MAX_FRAME_ID_LENGTH, SHAPES, Shape
from robotether_agent.guard.names import NAME, full_name
from robotether_agent.problems import StateUnusable

STOP_FILE = "stop.json"
MOTION_FILE = "motion.json"
MAX_BY_LENGTH = 100

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Driven:
    """A drive topic as it was driven; `type` as it was advertised, or empty."""

    topic: str
    shape: Shape
    type: str = ""
    frame_id: str = ""


class StopFile:
    """The latch on the disk."""

    def __init__(self, state_dir: Path) -> None:
        self._path = state_dir / STOP_FILE

    def read(self) -> str | None:
        """Return who stopped the robot, or None when it is not stopped."""
        try:
            text = read_text(self._path)
            return (
                None
                if text is None
                else get_text(parse_object(text, STOP_FILE), "by", limit=MAX_BY_LENGTH)
            )
        except (StateUnusable, FieldError) as error:
            log.error("%s cannot be read, so the robot is stopped: %s", self._path, error)  # noqa: TRY400 - no defect
            return ""

    def write(self, by: str) -> None:
        """Keep the stop; StateUnusable when that fails."""
        write_atomic(self._path, json.dumps({"by": by}) + "\n", 0o600)

    def remove(self) -> None:
        """Let the stop end; StateUnusable when that fails."""
        _remove(self._path)


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
        _remove(self._path)


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


def _remove(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise StateUnusable(f"cannot remove {path}: {error.strerror}") from error

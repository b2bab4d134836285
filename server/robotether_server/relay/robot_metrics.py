"""The numbers of each robot in Prometheus' text format, written at once: a library takes five times as long for them.

`metrics` asks for them. However much a robot reports, it has few series. What is unknown has no value.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Literal, NamedTuple

from robotether_server.db.fleet import Snapshot
from robotether_server.relay.channels.video.feeds import Feed, FeedKey
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.robot import Robot

# Maximum number of lines that are written at once, in some 2 ms.
LINES_IN_PART = 2000
# Encoders by their names in FFmpeg; a robot may report any text.
ENCODERS = frozenset(("h264_v4l2m2m", "h264_nvenc", "h264_qsv", "libx264", "libvpx"))

# The labels of a value beside the robot's, and the value.
Value = tuple[str, float]


class Family(NamedTuple):
    """One number of each robot."""

    name: str
    type: Literal["gauge", "counter"]
    meaning: str
    read: Callable[[Robot], Iterable[Value]]


def _one(value: float | None) -> Iterable[Value]:
    return () if value is None else (("", value),)


def _round_trip_s(robot: Robot) -> Iterable[Value]:
    rtt_ms = robot.presence.rtt_ms
    return _one(None if rtt_ms is None else rtt_ms / 1000)


def _battery(robot: Robot) -> Iterable[Value]:
    battery = robot.presence.battery
    return _one(None if battery is None else battery.percent)


def _stopped(robot: Robot) -> Iterable[Value]:
    return _one(robot.presence.report.stopped if robot.presence.guard == "ready" else None)


def _refusals(robot: Robot) -> Iterable[Value]:
    refused = robot.presence.report.refused
    return _one(sum(count for _, count in refused) if refused else None)


def _guard_stops(robot: Robot) -> Iterable[Value]:
    return [(f',cause="{cause}"', count) for cause, count in robot.presence.report.stops]


def _encoder(robot: Robot) -> Iterable[Value]:
    """Say what makes the frames of the cameras that are watched."""
    feeds = [feed for feed in robot.feeds.values() if isinstance(feed, Feed)]
    # JPEG beside H.264 of the same camera needs no encoder.
    statuses = [
        feed.status
        for feed in feeds
        if feed.key.decodes_h264 or FeedKey(feed.key.camera) not in robot.feeds
    ]
    encoders = {status.encoder for status in statuses if status and status.state == "live"}
    if not encoders:
        return ()
    encoder = encoders.pop() or "none" if len(encoders) == 1 else "several"
    is_named = encoder in ENCODERS or encoder in {"none", "several"}
    return ((f',encoder="{encoder if is_named else "other"}"', 1),)


UP = Family(
    "up", "gauge", "1: this cell has the robot's session", lambda r: _one(r.presence.online)
)
# Of robots that are online.
FAMILIES = (
    Family("round_trip_seconds", "gauge", "The newest round trip", _round_trip_s),
    Family("battery_percent", "gauge", "The battery, as the robot reports it", _battery),
    Family("stopped", "gauge", "1: the robot's guard reports a stop", _stopped),
    Family(
        "guard_refusals_total",
        "counter",
        "Drive commands that the robot's guard refused since its start",
        _refusals,
    ),
    Family(
        "guard_stops_total",
        "counter",
        "Times that the guard stopped the robot while it moved since the guard's start, by cause",
        _guard_stops,
    ),
    Family(
        "slowed_seconds_total",
        "counter",
        "Time for which the robot's guard slowed commands",
        lambda robot: _one(robot.slowed_s),
    ),
    Family(
        "frames_total",
        "counter",
        "Frames that came from the robot's cameras",
        lambda robot: _one(robot.camera_counts.frames),
    ),
    Family(
        "frame_bytes_total",
        "counter",
        "Bytes of these frames",
        lambda robot: _one(robot.camera_counts.bytes),
    ),
    Family("encoder_info", "gauge", "What encodes the cameras that are watched", _encoder),
)


def write_robots(snapshot: Snapshot, registry: SessionRegistry) -> Iterator[bytes]:
    """Write the numbers of all active robots, a few at a time."""
    rows = [row for row in snapshot.robots.values() if row.state == "active"]
    # Another robot may get the name.
    robots = [
        (f'robot="{_escaped(row.name)}",robot_id="{row.id}"', registry.robot(row.id))
        for row in rows
    ]
    online = [(labels, robot) for labels, robot in robots if robot.presence.online]
    yield from _written(UP, robots)
    for family in FAMILIES:
        yield from _written(family, online)


def _written(family: Family, robots: Sequence[tuple[str, Robot]]) -> Iterator[bytes]:
    name = f"robotether_robot_{family.name}"
    lines = [f"# HELP {name} {family.meaning}\n# TYPE {name} {family.type}\n"]
    for robot_labels, robot in robots:
        for labels, value in family.read(robot):
            lines.append(f"{name}{{{robot_labels}{labels}}} {float(value)}\n")
        if len(lines) > LINES_IN_PART:
            yield "".join(lines).encode()
            lines = []
    yield "".join(lines).encode()


def _escaped(name: str) -> str:
    return name.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")

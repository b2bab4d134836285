"""Which topics of a ROS graph, which several robots may share, are one's: the drive topic's namespace decides. Pure.

The drive page has the same rule (ownTopics.js); tests/unit/common/test_own_topics.py holds both to it. Types are spelt
as `same_type` returns them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

# Whatever takes one of these may be another robot.
DRIVE_TYPES = (
    "geometry_msgs/Twist",
    "geometry_msgs/TwistStamped",
    "ackermann_msgs/AckermannDriveStamped",
)


def own_topics(topics: Mapping[str, str], drive_topic: str) -> dict[str, str]:
    """Return the topics without those of other robots.

    Another robot is a branch that has a drive topic of its own and lies beside the namespace of this robot's, or in it
    where that is the root. Without a drive topic all are this robot's.
    """
    if not drive_topic:
        return dict(topics)
    *home, last = _segments(drive_topic)
    driving = [
        n for n, kind in topics.items() if kind in DRIVE_TYPES or _segments(n)[-1:] == [last]
    ]
    others = {_branch(name, home) for name in driving} - {None}
    return {name: kind for name, kind in topics.items() if _branch(name, home) not in others}


def own_topic(
    topics: Mapping[str, str], kind: str, usual: Sequence[str], drive_topic: str
) -> str | None:
    """Return this robot's topic of a type, or nothing where it has none or several fit equally well."""
    home = _segments(drive_topic)[:-1]
    own = [name for name, its in own_topics(topics, drive_topic).items() if its == kind]
    ranked = sorted((_rank(name, home, usual), name) for name in own)
    is_tie = len(ranked) > 1 and ranked[0][0] == ranked[1][0]
    return ranked[0][1] if ranked and not is_tie else None


def _segments(name: str) -> list[str]:
    return [segment for segment in name.split("/") if segment]


def _shared(path: Sequence[str], home: Sequence[str]) -> int:
    """Return how many leading segments both have."""
    pairs = zip(path, home, strict=False)
    return next((at for at, (a, b) in enumerate(pairs) if a != b), min(len(path), len(home)))


def _branch(name: str, home: Sequence[str]) -> tuple[str, ...] | None:
    """Return the namespace in which a topic leaves this robot's; None: it lies in it, or beside the way to it."""
    path = _segments(name)[:-1]
    shared = _shared(path, home)
    leaves = len(path) > shared and (shared < len(home) or not home)
    return tuple(path[: shared + 1]) if leaves else None


def _rank(name: str, home: Sequence[str], usual: Sequence[str]) -> tuple[int, int, int]:
    """Return what sorts the nearest namespace first, then the usual names, then what lies less deep."""
    path = _segments(name)
    shared = _shared(path[:-1], home)
    within_it = "/".join(path[shared:])
    place = usual.index(within_it) if within_it in usual else len(usual)
    return -shared, place, len(path)


def same_type(kind: str) -> str:
    """Return a type's name as ROS 1 spells it: without the /msg/ of ROS 2."""
    return kind.replace("/msg/", "/")

"""What the operators' experiment compares: networks, qualities, ways, and the names of its steps."""

from __future__ import annotations

from collections.abc import Mapping

from paper.profiles import TABLE_2, Profile

QUALITIES = (90, 80, 70, 60, 50)
# The range of qualities that a viewer has who asks for nothing else (docs/reference/media.md); in place of a quality.
ADAPTIVE = None
OURS, PLAIN = "ours", "plain"
ROBOTS, FPS = 3, 15
_NAMES = ("fixed-94", "fixed-288", "4g-7", "4g-31", "4g-80", "4g-5")
NETWORKS: Mapping[str, Profile] = dict(zip(_NAMES, TABLE_2, strict=True))


def step_name(network: str, quality: int | None) -> str:
    """The step of a network, by its short name, and a quality; "4g-7-q90" or "4g-7-adaptive"."""
    return f"{network}-adaptive" if quality is ADAPTIVE else f"{network}-q{quality}"

"""A robot as a run of the operators' experiment saw it, for tests of what the page makes of it."""

from __future__ import annotations

from typing import Any

from paper.operators_values import Seen


def seen(**changed: Any) -> Seen:
    """A robot with a picture of 20 KB each 100 ms and two commands."""
    values: dict[str, Any] = {
        "pictures": [(100.0 * number, 20_000, 50.0 + number) for number in range(10)],
        "camera_fps": 10.0,
        "quality": 80.0,
        "width_px": 640.0,
        "commands_ms": [20.0, 30.0],
        "driven_ms": [0.0, 50.0, 700.0],
        "refused": 0,
        "simulator_cpu": 0.1,
        "agent_cpu": 0.2,
    }
    return Seen(**{**values, **changed})

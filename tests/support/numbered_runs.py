"""A run of numbered messages as numbered_run.py returns it, for tests of what is reported of it."""

from __future__ import annotations

from typing import Any


def a_run(**changes: Any) -> dict[str, Any]:
    """What numbered_run.run returns of two pairs that lost nothing."""
    usual = {
        "title": "2 pairs",
        "pairs": 2,
        "count": 50,
        "rate_hz": 100,
        "to_robot": True,
        "frame_bytes": 200,
        "planned_s": 0.5,
        "sending_s": 0.6,
        "took_s": 1.0,
        "cpu_s": {
            "nginx": 0.01,
            "relay": 0.02,
            "sshd": 0.01,
            "robots": 0.1,
            "links": 0.0,
            "machine": 1.0,
            "senders": 0.05,
            "receivers": 0.05,
        },
        "cores": 2,
        "sent": 100,
        "unsent": 0,
        "received": 100,
        "lost": 0,
        "duplicated": 0,
        "reordered": 0,
        "foreign": 0,
        "redials": 0,
        "endings": [],
        "failed_dials": 0,
        "dial_failures": [],
        "missing": {},
        "latency": {"2.00": 99, "40.00": 1},
        "lateness": {"0.10": 100},
        "networks": {},
    }
    return {**usual, **changes}

"""What of a fleet falls short on its page."""

from __future__ import annotations

import math
from typing import Any

from paper.density.report import report
from paper.fleet.report import SERVER
from paper.step import Outcome


def run(*message_s: float | None) -> dict[str, Any]:
    """What a fleet's start or return brought; None: no message."""
    return {
        "message_s": list(message_s),
        "online_s": list(message_s),
        "server_s": 1.0,
        "received": sum(seconds is not None for seconds in message_s),
        "wrong": 0,
        "waits": {},
        "limits": [],
        "failures": [],
        "cpu_s": dict.fromkeys((*SERVER, "robots"), 0.1),
        "memory_bytes": dict.fromkeys(SERVER, 2**20),
        "took_s": 3.0,
    }


def drive(kind: str, *, lost: int = 0, endings: dict[str, int] | None = None) -> dict[str, Any]:
    times = {"1.00": 99, "60.00": 1}
    told = {"sent": 100, "unsent": 0, "lost": lost, "endings": endings or {}, "refused": {}}
    return {"robot": "one", "kind": kind, "round_trips": times, "late": times, **told}


def fleet(*drives: dict[str, Any], back: dict[str, Any] | None = None) -> Outcome:
    used = dict.fromkeys((*SERVER, "robots", "operators", "rest"), 0.5)
    driven = {"drives": list(drives), "fleet_cpu_s": used, "cpu_s": 0.5, "took_s": 2.0}
    values = {"count": 2, "agents": 1, "start": run(1.0, 2.0), "drive": driven}
    return Outcome(values={**values, "return": back or run(3.0, 4.0)})


def test_what_was_lost_or_did_not_come_back_falls_short():
    ended = drive("virtual", lost=1, endings={"close code 4408": 2})
    found = report({"fleet-2": fleet(ended, back=run(3.0, None))})
    short = {row.what for row in found.comparisons if row.is_short}
    assert "2 robots, late or never back after all containers restart" in short
    assert "2 robots, driven at 50 Hz: lost" in short
    assert any("close code 4408 (2)" in line for line in found.shortfalls)
    assert any("the return, all containers: 1 of 2 robots" in line for line in found.shortfalls)


def test_a_drive_that_failed_has_no_figure_and_is_told():
    outcome = fleet()
    assert outcome.values is not None
    failed = Outcome(values={**outcome.values, "drive": {"failure": "no lease"}})
    found = report({"fleet-2": failed})
    row = next(row for row in found.comparisons if row.what.endswith("50 Hz: lost"))
    assert math.isnan(row.ours)
    assert row.is_short
    assert "driving among 2 robots: no lease" in found.shortfalls

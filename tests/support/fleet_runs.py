"""Outcomes of fleets' runs, made up for tests of what the page makes of them."""

from __future__ import annotations

from typing import Any

from paper.step import Outcome


def run(*message_s: float | None, **others: Any) -> Outcome:
    """A run in which robots got their messages then; None: never."""
    got = sum(seconds is not None for seconds in message_s)
    usual = {
        "message_s": list(message_s),
        "online_s": list(message_s),
        "published": len(message_s),
        "received": got,
        "wrong": 0,
        "waits": {},
        "limits": [],
        "cpu_s": {"sshd": 4.0, "relay": 2.0},
        "memory_bytes": {"sshd": 2000},
        "server_s": 1.0,
        "took_s": 3.0,
        "failures": [],
    }
    return Outcome(values={**usual, **others})

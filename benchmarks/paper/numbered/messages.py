"""Numbered messages: which of them were lost, duplicated or reordered, and how late they came.

Each message carries the number of its pair, its own, and the moment in which it was
due, by the one clock of this machine (`time.monotonic_ns`). Latency counts from that moment and not from the one in
which it was sent, so that a sender that is held up hides nothing. Pure: no network, no clock of its own.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

TOPIC, TYPE = "/numbered", "std_msgs/String"
# The whole publish operation, as in round_trip.
FRAME_BYTES = 200
# So many of the missing are named.
NAMED_AT_MOST = 5
NS_A_MS = 1_000_000


class Histogram:
    """How often which time was seen; a time is kept to 0.01 ms, from 100 ms on to four digits."""

    def __init__(self, kept: Mapping[str, int] | None = None) -> None:
        # By ms as text, as JSON carries it.
        self._counts = Counter(kept or {})

    @classmethod
    def merged(cls, parts: Iterable[Mapping[str, int]]) -> Histogram:
        """Of several, as `as_json` made them."""
        return cls(sum(map(Counter, parts), Counter()))

    def add(self, ms: float) -> None:
        """Note one time in ms, which is not negative."""
        self._counts[f"{ms if ms < 100 else float(f'{ms:.4g}'):.2f}"] += 1

    def as_json(self) -> dict[str, int]:
        return dict(self._counts)

    @property
    def total(self) -> int:
        return self._counts.total()

    @property
    def times_ms(self) -> NDArray[np.float64]:
        return np.repeat(np.array(list(self._counts), dtype=float), list(self._counts.values()))

    def quantile_ms(self, part: float) -> float | None:
        """The time that `part` (0 to 1) of them stay below or reach; None where none is."""
        return float(np.quantile(self.times_ms, part)) if self.total else None


def publish(pair: int, number: int, due_ns: int) -> str:
    """The operation that publishes a message, FRAME_BYTES long."""
    empty = json.dumps({"op": "publish", "topic": TOPIC, "msg": {"data": ""}})
    text = f"{pair} {number} {due_ns}"
    return empty.replace('""', f'"{text:<{FRAME_BYTES - len(empty)}}"')


@dataclass
class Account:
    """What came of the `count` messages of one pair."""

    pair: int
    count: int
    received: int = 0
    duplicated: int = 0
    # Those with a number below one that came before.
    reordered: int = 0
    # Of another pair, or no message of ours.
    foreign: int = 0
    latency: Histogram = field(default_factory=Histogram)
    _highest: int = -1

    def __post_init__(self) -> None:
        self._seen = bytearray(self.count)

    @property
    def complete(self) -> bool:
        return self.received == self.count

    def note(self, data: str, now_ns: int) -> None:
        """Take a message's text, which came at `now_ns`."""
        pair, number, due_ns = _parse(data)
        if pair != self.pair or not 0 <= number < self.count:
            self.foreign += 1
        elif self._seen[number]:
            self.duplicated += 1
        else:
            self._seen[number] = 1
            self.received += 1
            self.reordered += number < self._highest
            self._highest = max(self._highest, number)
            self.latency.add((now_ns - due_ns) / NS_A_MS)

    def as_json(self) -> dict[str, Any]:
        """All of it, with the first numbers that are missing."""
        missing = [number for number, seen in enumerate(self._seen) if not seen]
        return {
            "pair": self.pair,
            "received": self.received,
            "duplicated": self.duplicated,
            "reordered": self.reordered,
            "foreign": self.foreign,
            "missing": missing[:NAMED_AT_MOST],
            "latency": self.latency.as_json(),
        }


def joined(
    sent: Iterable[Mapping[str, Any]], arrived: Iterable[Mapping[str, Any]]
) -> dict[str, Any]:
    """One run's figures, of what each sender and each receiver told."""
    senders, receivers = list(sent), list(arrived)
    totals = {
        name: sum(receiver[name] for receiver in receivers)
        for name in ("received", "duplicated", "reordered", "foreign")
    }
    sent_all = sum(sender["sent"] for sender in senders)
    return {
        **totals,
        "sent": sent_all,
        "lost": sent_all - totals["received"],
        # Connections that failed before the start, and why.
        "failed_dials": sum(sender["failed_dials"] for sender in (*senders, *receivers)),
        "dial_failures": sorted(
            {why for sender in (*senders, *receivers) for why in sender["dial_failures"]}
        ),
        "missing": {
            str(receiver["pair"]): receiver["missing"]
            for receiver in receivers
            if receiver["missing"]
        },
        "latency": _merged(receivers, "latency"),
        "lateness": _merged(senders, "lateness"),
    }


def _merged(parts: Iterable[Mapping[str, Any]], name: str) -> dict[str, int]:
    return Histogram.merged(part[name] for part in parts).as_json()


def _parse(data: str) -> tuple[int, int, int]:
    """Pair, number and the due moment; those of nobody for a text that is none of ours."""
    try:
        pair, number, due_ns = map(int, data.split())
    except ValueError:
        return -1, -1, 0
    return pair, number, due_ns

"""What is measured of Robotether and of what else a user would take, and its rows on the page. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from report import Row, quantiles

from paper.peers import measures, transports
from paper.peers.transports import (
    DEFAULT_QUALITY,
    FITTING_QUALITY,
    FRAMES,
    LINK,
    OURS,
    SSH,
    STRAIGHT,
    TITLES,
)
from paper.peers.vpn import WireGuard
from paper.step import Comparison, Report, Results, Scale, Values, succeeded

LATENCY, LOAD, CHANGES, PATIENCE = "latency", "load", "changes", "patience"
# What stands in the page's first table; of the rest only what is worse is told.
COMPARED = (
    "round trip p50, idle",
    "round trip p99, behind video",
    "new address, p50",
    "processor time, both sides",
)


@dataclass(frozen=True, kw_only=True)
class Plan:
    """How much is measured."""

    transports: Sequence[str] = tuple(TITLES)
    measures: Sequence[str] = (LATENCY, LOAD, CHANGES)
    # Of round trips, idle and behind each video; and until a video fills what it fills.
    seconds: float = 10.0
    settle_s: float = 5.0
    # How many of a transport's videos are looked at.
    videos: int = 2
    load_s: float = 6.0
    load_settle_s: float = 2.0
    connects: int = 5
    recovers: int = 5
    # Each of a bare `ssh -R`'s takes a minute, and one for which the operator waits takes two.
    ssh_recovers: int = 2

    def steps(self) -> list[tuple[str, str]]:
        """Transport and measure of each step; all transports of one measure stand together, as they are compared."""
        every = [(key, measure) for measure in self.measures for key in self.transports]
        return every + ([(SSH, PATIENCE)] if CHANGES in self.measures else [])


def plan_of(scale: Scale) -> Plan:
    if not scale.quick:
        return Plan()
    transports = (STRAIGHT, SSH, OURS)
    return Plan(transports=transports, measures=(LATENCY,), seconds=3.0, settle_s=2.0, videos=1)


def name_of(key: str, measure: str) -> str:
    return f"{key}-{measure}"


def report(plan: Plan, results: Results) -> Report:
    done = succeeded(results)
    by_measure = {
        measure: {key: done.get(name_of(key, measure)) for key in plan.transports}
        for measure in plan.measures
    }
    found = {key: figures(key, by_measure) for key in plan.transports}
    rows = [
        Comparison(what, TITLES[key], value, found[OURS][what][0], unit, better)
        for key in plan.transports
        if key != OURS
        for what, (value, unit, better) in found[key].items()
        if what in found[OURS]
    ]
    makers = {LATENCY: _latency_rows, LOAD: _load_rows, CHANGES: _changes_rows}
    tables = {
        measure: [
            row for key, values in some.items() for row in _rows(makers[measure], key, values)
        ]
        for measure, some in by_measure.items()
    }
    changes = by_measure.get(CHANGES, {}).get(OURS)
    lost = sum((changes or {}).get(name, []).count(None) for name in ("connect_s", "recover_s"))
    never = f"{lost} starts or new addresses after which no message passed"
    return Report(
        values={
            "plan": plan,
            "link": LINK,
            "tables": tables,
            "measures": measures,
            "transports": transports,
            "keepalive_s": WireGuard.KEEPALIVE_S,
            "patience": done.get(name_of(SSH, PATIENCE)),
        },
        comparisons=[row for row in rows if row.what in COMPARED],
        shortfalls=[*_losses(rows), *[never] * bool(lost)],
    )


def _rows(make: Any, key: str, values: Values | None) -> Iterator[Row]:
    if values is None:
        yield {"transport": f"{TITLES[key]}: failed or not run"}
    else:
        yield from ({"transport": TITLES[key], **row} for row in make(key, values))


def _latency_rows(_key: str, values: Values) -> Iterator[Row]:
    yield {"meanwhile": "idle", **_trips(values["idle_ms"])}
    for video, one in values["videos"].items():
        ages = quantiles(one["picture_ages_ms"], 0.5, 0.95, unit="ms")
        yield {
            "meanwhile": video,
            **_trips(one["round_trips_ms"]),
            "frames/s": one["pictures_per_s"],
            "KB each": one["picture_bytes"] / 1000,
            **{f"age {name}": ms for name, ms in ages.items()},
        }


def _trips(trips: Sequence[float]) -> Row:
    return {"round trips": len(trips), **quantiles(trips, 0.5, 0.99, 1, unit="ms")}


def _load_rows(key: str, values: Values) -> Iterator[Row]:
    mbit_s = values["payload_bit_s"] / 1e6
    assert LINK.up_mbit_s is not None
    row = {"Mbit/s": mbit_s, f"of the link's {LINK.up_mbit_s:g}": f"{mbit_s / LINK.up_mbit_s:.0%}"}
    sides = {
        f"{side}'s side, s per MB": values[f"{side}_cpu_s_per_mb"] for side in ("robot", "server")
    }
    yield row | (sides if key != STRAIGHT else {})


def _changes_rows(_key: str, values: Values) -> Iterator[Row]:
    row: dict[str, object] = {}
    for what, name in (("start", "connect_s"), ("new address", "recover_s")):
        row |= {f"{what} {column}": s for column, s in quantiles(values[name], 0.5, 1).items()}
        row[f"{what} never"] = f"{values[name].count(None)} of {len(values[name])}"
    yield row


def figures(
    key: str, by_measure: Mapping[str, Mapping[str, Values | None]]
) -> dict[str, tuple[float, str, str]]:
    """What a transport is compared by: value, unit and which is better, by what it is."""
    latency, load, changes = (
        by_measure.get(measure, {}).get(key) or {} for measure in (LATENCY, LOAD, CHANGES)
    )
    found: dict[str, tuple[float, str, str]] = {}
    if latency:
        found |= _round_trips(latency["idle_ms"], "idle")
    for meanwhile, video in (
        ("behind video", DEFAULT_QUALITY),
        ("behind video that fits", FITTING_QUALITY),
    ):
        if one := latency.get("videos", {}).get(FRAMES if key == OURS else video):
            age = np.quantile(one["picture_ages_ms"], 0.95)
            found |= _round_trips(one["round_trips_ms"], meanwhile)
            found[f"age of frames p95, {meanwhile}"] = (age, "ms", "lower")
            found[f"frames a second, {meanwhile}"] = (one["pictures_per_s"], "1/s", "higher")
    if load:
        found["throughput to the operator"] = (load["payload_bit_s"] / 1e6, "Mbit/s", "higher")
    if load and key != STRAIGHT:
        cost = load["robot_cpu_s_per_mb"] + load["server_cpu_s_per_mb"]
        found["processor time, both sides"] = (cost, "s per MB", "lower")
    for what, name in (("start", "connect_s"), ("new address", "recover_s")):
        p50 = pd.Series(changes.get(name, []), dtype=float).quantile(0.5)
        if not np.isnan(p50):
            found[f"{what}, p50"] = (p50, "s", "lower")
    return found


def _round_trips(trips: Sequence[float], meanwhile: str) -> dict[str, tuple[float, str, str]]:
    return {
        f"round trip p{100 * part:g}, {meanwhile}": (np.quantile(trips, part), "ms", "lower")
        for part in (0.5, 0.99)
    }


def _losses(rows: Sequence[Comparison]) -> list[str]:
    """A line for each figure that others have better, but for those of the first table."""
    worse: dict[str, list[Comparison]] = {}
    for row in rows:
        if row.is_short and row.what not in COMPARED:
            worse.setdefault(row.what, []).append(row)
    return [
        f"{what}: {some[0].ours:.3g} {some[0].unit}; "
        + "; ".join(f"{row.against}: {row.reference:.3g}" for row in some)
        for what, some in worse.items()
    ]

"""The rows of the operators' experiment: a table a network, and where plain MJPEG is better. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from report import Figure, Row, plain, quantiles

from paper.operators.run import (
    ADAPTIVE,
    FPS,
    LAST_S,
    NETWORKS,
    OURS,
    PLAIN,
    QUALITIES,
    ROBOTS,
    step_name,
)
from paper.step import Comparison, Report, Results, Scale, Values, exactly, succeeded

TITLES = {OURS: "Robotether", PLAIN: "plain MJPEG, bare ssh -R"}
# The quality that is most for a link, and is compared in the page's first table.
COMPARED = 90
# A camera that gives less than this share of what it should is held up by the machine.
HELD_UP = 0.97
# Of the machine's processors: beyond it nothing comes at its time.
FULL = 0.95
# Columns in which the two transports are compared, and which is better; and those of the page's first table.
MEASURES = {
    "frames/s": "higher",
    "width, pixels": "higher",
    "delay p95, ms": "lower",
    "age p50, ms": "lower",
    "age p95, ms": "lower",
    "command p50, ms": "lower",
    "command p99, ms": "lower",
}
FIRST_TABLE = ("frames/s", "age p95, ms", "command p99, ms")
AGE = "age p95, ms"
# By network, quality (None: adaptive) and transport.
Condition = tuple[str, int | None, str]


def figures(run: Values) -> dict[str, Any]:
    """The columns of one run: percentiles of all robots' samples, rates of one robot; empty where nothing came."""
    robots: Sequence[Mapping[str, Any]] = run["robots"]
    each = len(robots) * run["lasted_s"]
    frames = pd.DataFrame(
        [(at, *frame) for at, robot in enumerate(robots) for frame in robot["pictures"]],
        columns=["robot", "at_ms", "bytes", "age_ms"],
    ).astype(float)
    delays = frames.groupby("robot").at_ms.diff()
    commands = pd.Series([ms for robot in robots for ms in robot["commands_ms"]], dtype=float)
    of_robots = pd.DataFrame(robots)[["camera_fps", "quality", "width_px", "simulator_cpu"]]
    means = of_robots.astype(float).mean()
    pauses = [longest_pause_ms(robot["driven_ms"], run["lasted_s"]) for robot in robots]
    return {
        "frames/s": len(frames) / each,
        "camera's own": means.camera_fps,
        "asked quality": means.quality,
        "width, pixels": means.width_px,
        "KB a frame": frames.bytes.mean() / 1000,
        "Mbit/s a robot": frames.bytes.sum() * 8 / each / 1e6,
        "delay mean, ms": delays.mean(),
        "delay p95, ms": delays.quantile(0.95),
        **{
            f"age {name}": ms for name, ms in quantiles(frames.age_ms, 0.5, 0.95, unit="ms").items()
        },
        **{f"command {name}": ms for name, ms in quantiles(commands, 0.5, 0.99, unit="ms").items()},
        "lost": f"{commands.isna().sum()} of {len(commands)}",
        "refused": sum(robot["refused"] for robot in robots),
        "longest pause, ms": max(pauses),
        "simulator, % of a core": means.simulator_cpu * 100,
        "machine busy, %": run["busy"] * 100,
    }


def longest_pause_ms(moments_ms: Sequence[float], lasted_s: float) -> float:
    """The longest time in which nothing came, in ms; the beginning and the end count as moments."""
    return float(np.diff([0.0, *sorted(moments_ms), lasted_s * 1000]).max())


def report(_scale: Scale, results: Results) -> Report:
    """The page's part; what failed or has not run has no figures, and says so."""
    runs = measured_runs(results)
    table = {key: figures(run) for key, run in runs.items()}
    return Report(
        values={
            "robots": ROBOTS,
            "fps": FPS,
            "last_s": LAST_S,
            "networks": [
                (profile, rows)
                for network, profile in NETWORKS.items()
                if (rows := list(_rows(network, results, table)))
            ],
        },
        comparisons=list(_comparisons(runs, table)),
        shortfalls=[*_machine(runs, table), *_worse(table)],
        figure=_figure(table),
    )


def measured_runs(results: Results) -> dict[Condition, Values]:
    """All runs of the steps that succeeded, in the plan's order."""
    good = succeeded(results)
    return {
        (network, quality, transport): good[name][transport]
        for network in NETWORKS
        for quality in (*QUALITIES, ADAPTIVE)
        for transport in TITLES
        if transport in good.get(name := step_name(network, quality), {})
    }


def _rows(network: str, results: Results, table: Mapping[Condition, Row]) -> Iterator[Row]:
    for quality in (*QUALITIES, ADAPTIVE):
        asked = "adaptive" if quality is ADAPTIVE else str(quality)
        outcome = results.get(step_name(network, quality))
        if outcome is not None and outcome.values is None:
            yield {"quality": asked, "transport": f"failed: {plain(outcome.failure)}"}
        for transport, title in TITLES.items():
            if found := table.get((network, quality, transport)):
                yield {"quality": asked, "transport": title, **found}


def _figure(table: Mapping[Condition, Row]) -> Figure:
    points = [
        {"line": NETWORKS[network].name, "panel": TITLES[transport], "x": quality, "y": row[AGE]}
        for (network, quality, transport), row in table.items()
        if quality is not ADAPTIVE
    ]
    return Figure(
        caption=f"Age of the frames, p95, by JPEG quality, a line a network, {ROBOTS} robots at once.",
        lines=[pd.DataFrame(points).sort_values("x", kind="stable")] if points else [],
        x="JPEG quality",
        y=AGE,
        log="y",
        style="o-",
    )


def _comparisons(
    runs: Mapping[Condition, Values], table: Mapping[Condition, Row]
) -> Iterator[Comparison]:
    for (network, quality), (ours, peer) in _pairs(table).items():
        for name in FIRST_TABLE if quality == COMPARED else ():
            what = f"{name}, quality {quality}, {NETWORKS[network].name}"
            yield Comparison(what, TITLES[PLAIN], peer[name], ours[name], "", MEASURES[name])
    sent = [
        ms
        for (_, _, transport), run in runs.items()
        if transport == OURS
        for robot in run["robots"]
        for ms in robot["commands_ms"]
    ]
    if sent:
        came = len(sent) - sent.count(None)
        what = "commands that came while video went on"
        yield exactly(what, "all sent", len(sent), came, "messages")


def _machine(runs: Mapping[Condition, Values], table: Mapping[Condition, Row]) -> Iterator[str]:
    """Whether the machine held up what was measured."""
    rates = pd.Series({key: row["camera's own"] for key, row in table.items()}, dtype=float)
    slow = rates[rates < HELD_UP * FPS]
    if len(slow):
        network, quality, transport = slow.idxmin()
        yield (
            f"This machine was a limit in {len(slow)} of {len(runs)} runs: the simulated cameras themselves gave "
            f"fewer than {HELD_UP * FPS:.1f} frames a second, at the least {slow.min():.1f} "
            f"({_condition(network, quality)}, {TITLES[transport]})."
        )
    full = sum(run["busy"] > FULL for run in runs.values())
    if full:
        yield (
            f"This machine was over {FULL:.0%} busy in {full} of {len(runs)} runs: part of what is late or "
            "skipped there is its own, and no network's."
        )


def _worse(table: Mapping[Condition, Row]) -> Iterable[str]:
    """In which measures plain MJPEG is better, how often and by how much."""
    pairs = _pairs(table)
    for name, better in MEASURES.items():
        values = pd.DataFrame(
            [(ours[name], peer[name]) for ours, peer in pairs.values()],
            index=pd.MultiIndex.from_tuples(list(pairs)) if pairs else None,
            columns=["ours", "peer"],
            dtype=float,
        )
        for network, quality in values.index[values.ours.isna()]:
            yield f"No {name}, {_condition(network, quality)}: too little came."
        ratio = values.ours / values.peer
        factor = (ratio if better == "lower" else 1 / ratio).dropna()
        if (worse := factor[factor > 1]).size:
            one = values.loc[worse.idxmax()]
            yield (
                f"{name}: worse than plain MJPEG and rosbridge through a bare ssh -R in {len(worse)} of {len(pairs)} "
                f"runs, at the most {one.ours:.1f} beside {one.peer:.1f} ({_condition(*worse.idxmax())})."
            )


def _pairs(table: Mapping[Condition, Row]) -> dict[tuple[str, int | None], tuple[Row, Row]]:
    """Ours and plain of each network and quality that has both."""
    return {
        (network, quality): (table[network, quality, OURS], row)
        for (network, quality, transport), row in table.items()
        if transport == PLAIN and (network, quality, OURS) in table
    }


def _condition(network: str, quality: int | None) -> str:
    asked = "adaptive" if quality is ADAPTIVE else f"quality {quality}"
    return f"{NETWORKS[network].name}, {asked}"

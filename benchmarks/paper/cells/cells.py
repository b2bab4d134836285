"""Whether several cells keep their promises while they break.

A nemesis breaks things by a seed, which SEED in the environment sets. The history of all is checked by rules
(checker.py); one that breaks a rule is kept in tests/artifacts/cells.
"""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np
from demo import ROOT
from report import quantiles

from paper.cells.checker import check, find_ignored_stops, find_returns
from paper.cells.history import read
from paper.cells.site import Site
from paper.cells.workload import (
    DONE_WITHIN_S,
    SETTLES_WITHIN_S,
    WRITES_WITHIN_S,
    Size,
    Workload,
    at_work,
    judged,
    new_run,
    read_database,
)
from paper.step import Comparison, Part, Report, Scale, Step, Values, against_aim, never
from paper.world import World

# Of issue 18.
AIM_RETURN_P99_S = 5.0
MOST_SHOWN = 10
# A driver who gives up before has not waited for long enough to tell.
PATIENT_S = 5.0


def report(measured: Mapping[str, Values]) -> Report:
    run = measured.get("nemesis")
    if run is None:
        return Report()
    return Report(
        values={"nemesis": {**run, **_nemesis(run)}},
        comparisons=list(_comparisons(run)),
        shortfalls=list(_shortfalls(run)),
    )


def times(returns: Iterable[Mapping[str, Any]]) -> list[float]:
    return [
        outage["took_s"] for outage in returns if outage["came"] or outage["took_s"] > PATIENT_S
    ]


def _nemesis(run: Values) -> Values:
    by_cause: dict[str, list[Mapping[str, Any]]] = {}
    for outage in run["returns"]:
        by_cause.setdefault(outage["after"].replace("_", " ") or "no fault of a cell", []).append(
            outage
        )
    return {
        "faults": ", ".join(
            f"{name.replace('_', ' ')} ({count})" for name, count in run["faults"].items()
        ),
        "event_rows": [
            {"event": name.replace("_", " "), "times": count}
            for name, count in sorted(run["events"].items())
        ],
        "return_rows": [
            {"after": cause, "times": len(took), **quantiles(took, 0.5, 0.99, 1)}
            for cause, some in sorted(by_cause.items())
            if (took := times(some))
        ],
    }


def _comparisons(run: Values) -> Iterator[Comparison]:
    yield never("rules broken under the nemesis", run["broken"])
    yield never("processes and robots that failed", len(run["failed"]))
    # Without any, nobody was ever kept from driving.
    late = np.quantile(times(run["returns"]) or [0.0], 0.99)
    what = "drivable again once a live cell is there, p99"
    yield against_aim(what, AIM_RETURN_P99_S, float(late), "s")


def _shortfalls(run: Values) -> Iterator[str]:
    for violation in run["violations"][:MOST_SHOWN]:
        yield f"{violation['rule']}: {violation['robot']}: {violation['words']}"
    if run["kept"]:
        yield f"the history of seed {run['seed']} is in {run['kept']}"
    for words, count in Counter[str](run["failed"]).most_common(MOST_SHOWN):
        yield f"{count} times: {words}"
    if ignored := run["ignored_stops_s"]:
        yield (
            f"{len(ignored)} stops were taken by a cell that could not reach the robot's, and answered as not "
            f"confirmed; the robot was moved for up to {max(ignored):.1f} s more"
        )
    gave_up = sum(not outage["came"] and outage["took_s"] > PATIENT_S for outage in run["returns"])
    if gave_up:
        yield f"{gave_up} times a driver gave up before a robot was drivable again"


KEPT = ROOT / "tests" / "artifacts" / "cells"
WHOLE = Size(cells=3, agents=30, virtual=300, drivers=10, observers=10, operators=3, seconds=600.0)
QUICK = Size(cells=2, agents=4, virtual=16, drivers=4, observers=2, operators=2, seconds=120.0)
FULL_S = 1800.0
ONLINE_AGAIN_S = 120.0
# Without one of these a rule would have had nothing to judge.
JUDGED = ("arrived", "moved", "zeroed", "session", "stopped", "released", "stop_done", "recorded")


def steps_of(scale: Scale) -> Sequence[Step]:
    size = QUICK if scale.quick else replace(WHOLE, seconds=FULL_S) if scale.full else WHOLE
    title = f"{size.seconds / 60:.3g} minutes of nemesis"
    return [Step(name="nemesis", title=title, run=partial(run_nemesis, size))]


def run_nemesis(size: Size, world: World) -> Values:
    seed, folder = new_run(KEPT)
    with (
        Site.started(world, size.cells) as site,
        Workload.running(site, size, folder, seed) as workload,
    ):
        with at_work("paper.cells.people", folder, workload.order()) as people:
            done = asyncio.run(workload.nemesis(size.seconds))
            people.send("settle")
            seen = people.receive("what people have seen", DONE_WITHIN_S)
            online_s = workload.wait_online(ONLINE_AGAIN_S)
            people.receive("that operators have settled", SETTLES_WITHIN_S)
            failed = workload.end_route()
            time.sleep(WRITES_WITHIN_S)
            # What is released afterwards is no part of it.
            history, database = read(folder), read_database(site)
            people.send("end")
            people.receive("that all is released", SETTLES_WITHIN_S)
        failed += workload.failed
    follower = workload.routed[1]
    violations = check(history, database, follower)
    events = Counter[str](item.kind for item in history)
    unseen = [f"nobody saw an event {kind}" for kind in JUDGED if not events[kind]]
    last = {item.kind: item.at_s for item in history if item.robot in ("", follower)}
    if last.get("moved", 0.0) <= last.get("healed", 0.0):
        unseen.append("the route carried no command after all was mended")
    values = {
        "seed": seed,
        "size": asdict(size),
        "faults": dict(Counter(done)),
        "events": dict(events),
        "returns": [asdict(violation) for violation in find_returns(history, site.names)],
        "ignored_stops_s": [round(violation, 3) for violation in find_ignored_stops(history)],
        "seen": seen,
        "failed": [*failed, *seen["failed"], *unseen],
        "online_s": online_s,
    }
    return judged(folder, violations, values)


PART = Part(
    name="cells",
    title="Cells that break",
    steps=steps_of,
    report=report,
)

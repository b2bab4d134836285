"""The rows of cells, with the aims beside. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from report import quantiles

from paper.step import Comparison, Report, Values, against_aim, never

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
    """Of robots that came back, and of those whose drivers waited for long in vain."""
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

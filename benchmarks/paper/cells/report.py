"""The rows of cells, with the aims beside. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import pandas as pd
from report import Row, quantiles

from paper.numbered.messages import Histogram
from paper.step import Comparison, Report, Results, Values, against_aim, exactly, succeeded

# Of issue 18.
AIM_RETURN_P99_S = 5.0
MOST_SHOWN = 10
# A driver who gives up before has not waited for long enough to tell.
PATIENT_S = 5.0


def report(results: Results) -> Report:
    """The part's report, of the steps that have run."""
    values = succeeded(results)
    run = {name.replace("-", "_"): one for name, one in values.items()}
    spread = [one for name, one in values.items() if name.startswith("spread-")]
    makers = {
        "nemesis": _nemesis,
        "cell_killed": _killed,
        "database_away": _away,
        "drain": _drain,
        "forwarding": _forwarding,
    }
    return Report(
        values={
            **dict.fromkeys(makers),
            **{
                name: {**run[name], **make(run[name])}
                for name, make in makers.items()
                if name in run
            },
            "spread": _spread_rows(spread),
            "share": spread[0]["share"] if spread else None,
        },
        comparisons=list(_comparisons(run)),
        shortfalls=list(_shortfalls(run)),
    )


def times(returns: Iterable[Mapping[str, Any]]) -> list[float]:
    """Of robots that came back, and of those whose drivers waited for long in vain."""
    return [one["took_s"] for one in returns if one["came"] or one["took_s"] > PATIENT_S]


def _nemesis(run: Values) -> Values:
    by_cause: dict[str, list[Mapping[str, Any]]] = {}
    for one in run["returns"]:
        by_cause.setdefault(one["after"].replace("_", " ") or "no fault of a cell", []).append(one)
    return {
        "p99_ms": Histogram(run["seen"]["round_trips"]).quantile_ms(0.99),
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


def _killed(run: Values) -> Values:
    used = pd.Series(run["cpu_s"], dtype=float)
    # The services of all cells together, most first.
    shares = used.groupby([name.split()[0] for name in used.index]).sum()
    words = shares.sort_values(ascending=False, kind="stable").items()
    back = [one for one in run["took_s"] if one is not None]
    row = {"robots": run["robots"], "drivable elsewhere": len(back)}
    return {
        "worked_s": f"{used.sum():.1f}",
        "shares": ", ".join(f"{name} {seconds:.1f}" for name, seconds in words),
        "rows": [{**row, **quantiles(back, 0.5, 0.99, 1)}],
    }


def _driven(drives: Sequence[Mapping[str, Any]]) -> Row:
    return {
        "commands": sum(one["sent"] for one in drives),
        "lost": sum(one["lost"] for one in drives),
        "not sent": sum(one["unsent"] for one in drives),
        "connections that ended": sum(sum(one["endings"].values()) for one in drives),
    }


def _lost(drives: Sequence[Mapping[str, Any]]) -> float:
    return float(sum(one["lost"] + one["unsent"] for one in drives))


def _began(run: Values) -> int:
    return sum(one["began"] for one in run["begun"])


def _away(run: Values) -> Values:
    row = {
        "open drives": len(run["open"]),
        **_driven(run["open"]),
        "other drives began": f"{_began(run)} of {len(run['begun'])}",
        "recorded later": f"{run['recorded']} of {_began(run)}",
    }
    return {"rows": [row]}


def _drain(run: Values) -> Values:
    row = {"driven": len(run["drives"]), **_driven(run["drives"]), "empty after, s": run["empty_s"]}
    return {"rows": [row]}


def _spread_rows(runs: Sequence[Values]) -> Iterator[Row]:
    carried = [
        sum(one["sent"] - one["lost"] for one in run["drives"]) / float(run["seconds"])
        for run in runs
    ]
    for run, a_s in zip(runs, carried, strict=True):
        yield {
            "cells": run["cells"],
            "robots": run["robots"],
            "all online, s": run["online_s"],
            "robots a s": run["robots"] / run["online_s"],
            "commands heard a s": a_s,
            "times one cell": a_s / carried[0] if carried[0] else None,
            "cores used": " / ".join(f"{one / run['seconds']:.2f}" for one in run["cpu_s"]),
        }


def _forwarding(run: Values) -> Values:
    rows = []
    for name, words in (("own", "its own cell"), ("other", "another cell")):
        trips = Histogram(run[name])
        some = quantiles(trips.times_ms, 0.5, 0.99, 1, unit="ms")
        rows.append({"through": words, "messages": trips.total, **some})
    return {"rows": rows}


def _rule(what: str, ours: float, unit: str) -> Comparison:
    return exactly(what, "rule", 0.0, float(ours), unit)


def _p99_s(took_s: Iterable[float | None]) -> float | None:
    known = pd.Series(list(took_s), dtype=float).dropna()
    return float(known.quantile(0.99)) if len(known) else None


def _comparisons(values: Mapping[str, Values]) -> Iterator[Comparison]:
    if run := values.get("nemesis"):
        yield _rule("rules broken under the nemesis", run["broken"], "times")
        yield _rule("processes and robots that failed", len(run["failed"]), "times")
        # Without any, nobody was ever kept from driving.
        late = _p99_s(times(run["returns"]) or [0.0])
        what = "drivable again once a live cell is there, p99"
        yield against_aim(what, AIM_RETURN_P99_S, late, "s")
    if run := values.get("cell_killed"):
        never = run["took_s"].count(None)
        yield _rule("robots of a killed cell that never came back", never, "robots")
        what = "drivable elsewhere after a cell is killed, p99"
        yield against_aim(what, AIM_RETURN_P99_S, _p99_s(run["took_s"]), "s")
    if run := values.get("database_away"):
        began, ended = _began(run), _driven(run["open"])["connections that ended"]
        for what, ours, unit in (
            ("open drives that ended without the database", ended, "drives"),
            ("commands lost without the database", _lost(run["open"]), "commands"),
            ("drives that did not begin without the database", len(run["begun"]) - began, "drives"),
            (
                "drives without the database that were not recorded later",
                began - run["recorded"],
                "drives",
            ),
        ):
            yield against_aim(what, 0.0, ours, unit)
    if run := values.get("drain"):
        yield against_aim("commands lost in a drain", 0.0, _lost(run["drives"]), "commands")
        left = float(run["empty_s"] is None)
        yield against_aim("drains that left robots behind", 0.0, left, "drains")


def _shortfalls(values: Mapping[str, Values]) -> Iterator[str]:
    if run := values.get("nemesis"):
        for one in run["violations"][:MOST_SHOWN]:
            yield f"{one['rule']}: {one['robot']}: {one['words']}"
        if run["kept"]:
            yield f"the history of seed {run['seed']} is in {run['kept']}"
        for words, count in Counter(run["failed"]).most_common(MOST_SHOWN):
            yield f"{count} times: {words}"
        if ignored := run["ignored_stops_s"]:
            yield (
                f"{len(ignored)} stops were taken by a cell that could not reach the robot's, and answered as not "
                f"confirmed; the robot was moved for up to {max(ignored):.1f} s more"
            )
        gave_up = sum(not one["came"] and one["took_s"] > PATIENT_S for one in run["returns"])
        if gave_up:
            yield f"{gave_up} times a driver gave up before a robot was drivable again"
    if run := values.get("database_away"):
        why = Counter(one["why"] for one in run["begun"] if not one["began"])
        for words, count in why.most_common(3):
            yield f"without the database {count} drives did not begin: {words:.200}"

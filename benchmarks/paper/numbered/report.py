"""The rows of runs of numbered messages, and what falls short in them.

Used by high_rate.py with what run.py returned, in the runs' order. Pure.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from report import Figure, Row, number, quantiles, tail

from paper.numbered.messages import Histogram
from paper.numbered.run import SERVICES
from paper.step import Comparison, Values, exactly

# From here on a machine has no time left for what comes at once.
FULL = 0.95
MICROSECONDS = 1e6
# What the experiment is made of beside the server.
BESIDE = ("robots", "senders", "receivers")
CAPTION = "The share of messages that came later than a latency; both axes are logarithmic."


def flattened(values: Mapping[str, Any]) -> dict[str, Values]:
    """The runs of all steps that succeeded, by the runs' names; a step has one or more."""
    return {name: run for step in values.values() for name, run in step["runs"].items()}


def delivery_rows(runs: Iterable[Values]) -> Iterable[Row]:
    return map(_delivery, runs)


def _delivery(run: Values) -> Row:
    return {
        "run": run["title"],
        "pairs": run["pairs"],
        "messages a pair": run["count"],
        "Hz": run["rate_hz"],
        **{name: run[name] for name in ("sent", "lost", "duplicated", "reordered")},
        **quantiles(Histogram(run["latency"]).times_ms, 0.5, 0.99, 0.999, 1, unit="ms"),
        "sender late p50, ms": Histogram(run["lateness"]).quantile_ms(0.5),
        "sender late p99, ms": Histogram(run["lateness"]).quantile_ms(0.99),
    }


def cost_rows(runs: Iterable[Values]) -> Iterable[Row]:
    for run in runs:
        used, messages = run["cpu_s"], max(1, run["received"])
        yield {
            "run": run["title"],
            **{
                f"µs a message: {name}": used[name] / messages * MICROSECONDS
                for name in (*SERVICES, "robots")
            },
            "messages/s a core of the server": 1 / max(1 / MICROSECONDS, server_cost_s(run)),
            **{
                f"{name}, share of a core": f"{used[name] / run['took_s']:.0%}"
                for name in ("senders", "receivers")
            },
            "machine busy": f"{busy(run):.0%}",
            "others' share": f"{_others(run):.0%}",
        }


def server_cost_s(run: Values) -> float:
    """Processor time of all server processes for a message."""
    return float(sum(run["cpu_s"][name] for name in SERVICES) / max(1, run["received"]))


def busy(run: Values) -> float:
    """The share (0 to 1) of all cores that something used, whatever it was."""
    return float(run["cpu_s"]["machine"] / (run["took_s"] * run["cores"]))


def _others(run: Values) -> float:
    """The share of all cores that was used by what has nothing to do with a run."""
    used = run["cpu_s"]
    known = sum(used[name] for name in (*SERVICES, *BESIDE))
    return float(max(0.0, used["machine"] - known) / (run["took_s"] * run["cores"]))


def compared(run: Values) -> Comparison:
    """Beside the paper, which lost none."""
    what = f"{run['title']}: messages of {run['pairs'] * run['count']:,} that did not arrive"
    return exactly(what, "paper", 0, run["lost"], "messages")


def shortfalls(runs: Iterable[Values]) -> list[str]:
    """What is not as it should be, in sentences."""
    return [f"{run['title']}: {sentence}" for run in runs for sentence in _shortfalls(run)]


def _shortfalls(run: Values) -> Iterable[str]:
    if run["lost"]:
        where = "; ".join(
            f"pair {pair}: {', '.join(map(str, some))}" for pair, some in run["missing"].items()
        )
        lost = f"{run['lost']:,} of {run['sent']:,} messages that were sent did not arrive"
        yield f"{lost} (the first of {where})."
    for name in ("duplicated", "reordered", "foreign"):
        if run[name]:
            yield f"{run[name]:,} messages were {name}."
    if run["failed_dials"]:
        why = ", ".join(run["dial_failures"])
        yield f"{run['failed_dials']} connections failed before the start ({why}) and were dialled again."
    if busy(run) > FULL:
        p99 = Histogram(run["latency"]).quantile_ms(0.99)
        late = "" if p99 is None else f" (p99 {number(p99)} ms)"
        yield (
            f"the machine was {busy(run):.0%} busy ({_others(run):.0%} with other work), so latency{late} is "
            "that of a full machine with all ends on it, not of the connection."
        )


def latency_figure(runs: Iterable[Values]) -> Figure:
    lines = [
        tail(run["title"], Histogram(run["latency"]).times_ms) for run in runs if run["latency"]
    ]
    return Figure(
        caption=CAPTION,
        lines=lines,
        x="latency from when a message was due, ms",
        y="share of messages that came later",
        log="xy",
    )

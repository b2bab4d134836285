"""What runs of numbered messages look like on the page: tables, the figure, raw data, and what falls short.

Used by high_rate.py and mixed.py with what run.py returned, in the runs' order. Pure.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from sections import NONE, Section, number

from paper.numbered.messages import Histogram
from paper.step import Comparison, Data, Plot, Values

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

QUANTILES = (0.5, 0.99, 0.999, 1.0)
# From here on a machine has no time left for what comes at once.
FULL = 0.95
POINTS_A_DECADE = 60
MICROSECONDS = 1e6
SERVICES = ("nginx", "relay", "sshd")
# What the experiment is made of beside the server.
BESIDE = ("robots", "links", "senders", "receivers")
COLUMNS = (
    "run | pairs | messages a pair | Hz | sent | lost | duplicated | reordered | redialled | p50 | p99 | p99.9 | max "
    "| sender late p50 | p99"
)
COST_COLUMNS = (
    "run | µs a message: nginx | relay | sshd | robots | messages/s a core of the server | share of a core: senders "
    "| receivers | links | machine busy | others' share"
)
COST_TEXT = (
    "Processor time for a message, of each container on its way and of the robots (agents, guards, OpenSSH and "
    "rosbridge); how many messages a core of the server could pass on if it did nothing else; the processes that send, "
    "receive and emulate networks, as shares of one core; and how much of all cores was used, and how much of it by "
    "other work."
)


def flattened(values: Mapping[str, Any]) -> dict[str, Values]:
    """The runs of all steps that succeeded, by the runs' names; a step has one or more."""
    return {name: run for step in values.values() for name, run in step["runs"].items()}


def sections(title: str, text: str, runs: Mapping[str, Values]) -> list[Section]:
    """A row a run, by the titles, and what the runs cost; times in ms."""
    rows = [_delivery(*one) for one in with_networks(runs).items()]
    costs = [_cost(*one) for one in runs.items()]
    return [
        Section(title, text, COLUMNS, rows),
        Section("What they cost", COST_TEXT, COST_COLUMNS, costs),
    ]


def with_networks(runs: Mapping[str, Values]) -> dict[str, Values]:
    """The runs, and behind each what it was on each kind of network, if there were several."""
    found: dict[str, Values] = {}
    for title, run in runs.items():
        found[title] = run
        found |= {f"of these {kind}": part for kind, part in run["networks"].items()}
    return found


def _delivery(title: str, run: Values) -> Sequence[object]:
    latency, lateness = Histogram.of(run["latency"]), Histogram.of(run["lateness"])
    planned = run["pairs"] * run["count"]
    sent = f"{run['sent']:,}" + ("" if run["sent"] == planned else f" of {planned:,}")
    return (
        title,
        run["pairs"],
        f"{run['count']:,}",
        f"{run['rate_hz']:g}",
        sent,
        *(f"{run[name]:,}" for name in ("lost", "duplicated", "reordered", "redials")),
        *(ms(latency.quantile_ms(part)) for part in QUANTILES),
        *(ms(lateness.quantile_ms(part)) for part in QUANTILES[:2]),
    )


def ms(value: float | None) -> str:
    """A time in ms for a table."""
    return NONE if value is None else f"{value:.2f}" if value < 100 else f"{value:,.0f}"


def _cost(title: str, run: Values) -> Sequence[str]:
    used, messages = run["cpu_s"], max(1, run["received"])
    return (
        title,
        *(f"{used[name] / messages * MICROSECONDS:.0f}" for name in (*SERVICES, "robots")),
        f"{1 / max(1 / MICROSECONDS, server_cost_s(run)):,.0f}",
        *(f"{used[name] / run['took_s']:.0%}" for name in ("senders", "receivers", "links")),
        f"{busy(run):.0%}",
        f"{_others(run):.0%}",
    )


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


def compared(title: str, run: Values) -> Comparison:
    """Beside the paper, which lost none; a message that could not be sent counts too."""
    planned = run["pairs"] * run["count"]
    return Comparison(
        what=f"{title}: messages of {planned:,} that did not arrive",
        against="paper",
        reference=0,
        ours=run["lost"] + run["unsent"],
        unit="messages",
        better="equal",
    )


def shortfalls(runs: Mapping[str, Values]) -> list[str]:
    """What is not as it should be, in sentences."""
    return [sentence for title, run in runs.items() for sentence in _shortfalls(title, run)]


def _shortfalls(title: str, run: Values) -> Iterable[str]:
    if run["lost"]:
        where = "; ".join(
            f"pair {pair}: {', '.join(map(str, some))}" for pair, some in run["missing"].items()
        )
        lost = f"{run['lost']:,} of {run['sent']:,} messages that were sent did not arrive"
        yield f"{title}: {lost} (the first of {where})."
    if run["unsent"]:
        yield (
            f"{title}: {run['unsent']:,} messages could not be sent in the time: connections took less."
        )
    for name in ("duplicated", "reordered", "foreign"):
        if run[name]:
            yield f"{title}: {run[name]:,} messages were {name}."
    if run["redials"]:
        why = ", ".join(run["endings"])
        yield f"{title}: {run['redials']} connections ended in mid-run ({why}) and were dialled again."
    # A run of before this was told would have ended by it.
    if failed := run.get("failed_dials", 0):
        why = ", ".join(run["dial_failures"])
        yield f"{title}: {failed} connections failed before the start ({why}) and were dialled again."
    if busy(run) > FULL:
        p99 = Histogram.of(run["latency"]).quantile_ms(0.99)
        late = "" if p99 is None else f" (p99 {number(p99)} ms)"
        yield (
            f"{title}: the machine was {busy(run):.0%} busy ({_others(run):.0%} with other work), so latency{late} is "
            "that of a full machine with all ends on it, not of the connection."
        )


def latency_plot(name: str, caption: str, runs: Mapping[str, Values]) -> Plot:
    """Which share of the messages came later than each latency, both axes logarithmic."""
    return Plot(name=name, caption=caption, draw=partial(draw, runs=runs))


def draw(drawing: Drawing, runs: Mapping[str, Values]) -> None:
    """A curve for each run; for each kind of network, where a run has several."""
    axes = drawing.subplots()
    for title, run in runs.items():
        for label, part in (run["networks"] or {title: run}).items():
            points = thinned(Histogram.of(part["latency"]).exceeded_by())
            axes.step(*zip(*points, strict=True), where="post", label=label, linewidth=1.2)
    axes.set(xscale="log", yscale="log", xlabel="latency from when a message was due, ms",
             ylabel="share of messages that came later")  # fmt: skip
    axes.legend(fontsize=8)


def thinned(points: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """Those of a falling share that a logarithmic axis can show apart; the first and the last above 0 always."""
    shown = [(ms, share) for ms, share in points if share > 0] or [(1.0, 1.0)]
    kept = {round(math.log10(share) * POINTS_A_DECADE): (ms, share) for ms, share in shown}
    return sorted({shown[0], *kept.values(), shown[-1]})


def latency_data(prefix: str, named: Mapping[str, Values]) -> list[Data]:
    """A file a run, by the runs' names: how many messages had which latency on which network."""
    return [
        Data(
            name=f"{prefix}-{name}",
            about=f"{run['title']}: messages by latency from when they were due, to 0.01 ms, from 100 ms to 4 digits",
            header=("network", "latency_ms", "messages"),
            rows=[
                (kind, f"{ms:.2f}", count)
                for kind, part in (run["networks"] or {"": run}).items()
                for ms, count in Histogram.of(part["latency"]).rows()
            ],
        )
        for name, run in named.items()
    ]

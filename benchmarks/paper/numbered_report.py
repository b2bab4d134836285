"""What runs of numbered messages look like on the page: tables, the figure, raw data, and what falls short.

Used by high_rate.py and mixed.py with what numbered_run.py returned, in the runs' order. Pure.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from paper.numbered import Histogram
from paper.step import Comparison, Data, Plot, Values
from paper.words import number

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
    "run", "pairs", "messages a pair", "Hz", "sent", "lost", "duplicated", "reordered", "redialled",
    "p50", "p99", "p99.9", "max", "sender late p50", "p99",
)  # fmt: skip
COST_COLUMNS = ("run", "µs a message: nginx", "relay", "sshd", "robots",
                "messages/s a core of the server", "share of a core: senders", "receivers", "links",
                "machine busy", "others' share")  # fmt: skip


COST_TEXT = (
    "The first columns are the processor time for a message, of each container on its way and of the "
    "robots (agents, guards, OpenSSH and rosbridge). The next is how many messages a core of the server "
    "could pass on if it did nothing else, from the three containers' times. The next are the processes "
    "that send, receive and emulate networks, as shares of one core. The last two are how much of all "
    "cores was used, and how much of it by other work."
)


def delivery_table(runs: Mapping[str, Values]) -> list[str]:
    """Markdown lines: a row a run, by the titles; times in ms."""
    return table(COLUMNS, (_delivery(title, run) for title, run in with_networks(runs).items()))


def with_networks(runs: Mapping[str, Values]) -> dict[str, Values]:
    """The runs, and behind each what it was on each kind of network, if there were several."""
    found: dict[str, Values] = {}
    for title, run in runs.items():
        found[title] = run
        found |= {f"of these {kind}": part for kind, part in run["networks"].items()}
    return found


def cost_table(runs: Mapping[str, Values]) -> list[str]:
    """Markdown lines: who used how much of the processor for these runs."""
    return table(COST_COLUMNS, (_cost(title, run) for title, run in runs.items()))


def not_delivered(run: Values) -> int:
    """How many of the planned messages did not arrive, whether sent or not."""
    return int(run["lost"] + run["unsent"])


def compared(title: str, run: Values) -> Comparison:
    """Beside the paper, which lost none."""
    planned = run["pairs"] * run["count"]
    return Comparison(
        what=f"{title}: messages of {planned:,} that did not arrive",
        against="paper",
        reference=0,
        ours=not_delivered(run),
        unit="messages",
        better="equal",
    )


def shortfalls(runs: Mapping[str, Values]) -> list[str]:
    """What is not as it should be, in sentences."""
    return [sentence for title, run in runs.items() for sentence in _shortfalls(title, run)]


def busy(run: Values) -> float:
    """The share (0 to 1) of all cores that something used, whatever it was."""
    return float(run["cpu_s"]["machine"] / (run["took_s"] * run["cores"]))


def latency_plot(name: str, caption: str, runs: Mapping[str, Values]) -> Plot:
    """Which share of the messages came later than each latency, both axes logarithmic."""

    def draw(drawing: Drawing) -> None:
        axes = drawing.subplots()
        for title, run in _apart(runs).items():
            points = thinned(Histogram.of(run["latency"]).exceeded_by())
            axes.step(*zip(*points, strict=True), where="post", label=title, linewidth=1.2)
        axes.set(xscale="log", yscale="log", xlabel="latency from when a message was due, ms",
                 ylabel="share of messages that came later")  # fmt: skip
        axes.legend(fontsize=8)

    return Plot(name=name, caption=caption, draw=draw)


def _apart(runs: Mapping[str, Values]) -> dict[str, Values]:
    """One curve for each run; for each kind of network, where a run has several."""
    curves: dict[str, Values] = {}
    for title, run in runs.items():
        curves |= run["networks"] or {title: run}
    return curves


def thinned(points: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """Those of a falling share that a logarithmic axis can show apart; the first and the last above 0 always."""
    shown = [(ms, share) for ms, share in points if share > 0] or [(1.0, 1.0)]
    kept = {round(math.log10(share) * POINTS_A_DECADE): (ms, share) for ms, share in shown}
    return sorted({shown[0], *kept.values(), shown[-1]})


def latency_data(named: Mapping[str, Values]) -> list[Data]:
    """A file a run, by the runs' names: how many messages had which latency on which network."""
    return [
        Data(
            name=f"latency-{name}",
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


def ms(value: float | None) -> str:
    """A time in ms for a table."""
    return "-" if value is None else f"{value:.2f}" if value < 100 else f"{value:,.0f}"


def _delivery(title: str, run: Values) -> Sequence[str]:
    latency, lateness = Histogram.of(run["latency"]), Histogram.of(run["lateness"])
    planned = run["pairs"] * run["count"]
    sent = f"{run['sent']:,}" + ("" if run["sent"] == planned else f" of {planned:,}")
    return (
        title,
        str(run["pairs"]),
        f"{run['count']:,}",
        f"{run['rate_hz']:g}",
        sent,
        *(f"{run[name]:,}" for name in ("lost", "duplicated", "reordered", "redials")),
        *(ms(latency.quantile_ms(part)) for part in QUANTILES),
        *(ms(lateness.quantile_ms(part)) for part in QUANTILES[:2]),
    )


def _cost(title: str, run: Values) -> Sequence[str]:
    used, messages = run["cpu_s"], max(1, run["received"])
    return (
        title,
        *(f"{used[name] / messages * MICROSECONDS:.0f}" for name in (*SERVICES, "robots")),
        f"{run['received'] / max(0.001, sum(used[name] for name in SERVICES)):,.0f}",
        *(_percent(used[name] / run["took_s"]) for name in ("senders", "receivers", "links")),
        _percent(busy(run)),
        _percent(_others(run)),
    )


def _others(run: Values) -> float:
    """The share of all cores that was used by what has nothing to do with a run."""
    used = run["cpu_s"]
    known = sum(used[name] for name in (*SERVICES, *BESIDE))
    return float(max(0.0, used["machine"] - known) / (run["took_s"] * run["cores"]))


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
        others = _percent(_others(run))
        yield (
            f"{title}: the machine was {_percent(busy(run))} busy ({others} with other work), so that latency{late} is "
            "that of a full machine with all ends on it, not of the connection."
        )


def _percent(share: float) -> str:
    return f"{share:.0%}"


def table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Markdown lines; the first column is of words."""
    lines = [columns, ["---", *("---:" for _ in columns[1:])], *rows]
    return [f"| {' | '.join(line)} |" for line in lines]


def flattened(values: Mapping[str, Any]) -> dict[str, Values]:
    """The runs of all steps that succeeded, by the runs' names; a step has one or more."""
    return {name: run for step in values.values() for name, run in step["runs"].items()}

"""The figure of the comparison: round trips of every way, idle and behind video."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from sections import quantile

from paper.step import Plot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Round trips in ms by the way and what went on meanwhile.
Conditions = Mapping[str, Mapping[str, Sequence[float]]]
COLOURS = ("#0072b2", "#d55e00", "#e69f00")
TICKS_MS = (20, 50, 100, 200, 500, 1000, 2000)
BETWEEN_TRANSPORTS = 0.6


def plots(conditions: Conditions) -> list[Plot]:
    """One figure, or none when nothing was measured."""
    if not conditions:
        return []
    caption = (
        "Round trips of a 200-byte message by transport, idle and behind video: the point is the median, the line "
        "ends at the 99th percentile."
    )
    return [
        Plot(
            name="peers-round-trips",
            caption=caption,
            draw=lambda drawing: draw(drawing, conditions),
        )
    ]


def draw(drawing: Figure, conditions: Conditions) -> None:
    """A row for each way and what went on meanwhile, on a logarithmic axis."""
    axes = drawing.add_subplot()
    positions: list[float] = []
    names = []
    position = 0.0
    for transport, measured in conditions.items():
        for number, (meanwhile, trips) in enumerate(measured.items()):
            colour = COLOURS[number % len(COLOURS)]
            p50, p99 = quantile(trips, 0.5), quantile(trips, 0.99)
            axes.plot([p50, p99], [position, position], color=colour, linewidth=2)
            axes.plot([p50], [position], color=colour, marker="o")
            positions.append(position)
            names.append(f"{transport}, {meanwhile}")
            position += 1
        position += BETWEEN_TRANSPORTS
    axes.set_yticks(positions, names, fontsize=8)
    axes.invert_yaxis()
    axes.set_xscale("log")
    axes.set_xticks(TICKS_MS, [str(tick) for tick in TICKS_MS])
    axes.set_xlabel("round trip, ms")
    drawing.set_size_inches(8.0, 1.2 + 0.3 * len(positions))

"""The operators' figures: throughput and delay between frames in the paper's form, then ages and latencies. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

from matplotlib.ticker import LogFormatter

from paper.operators_plan import NETWORKS, OURS, PLAIN, QUALITIES
from paper.operators_values import Summary
from paper.step import Plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawing

SIZE_INCHES = (10.0, 7.5)
TITLES = {OURS: "Robotether", PLAIN: "plain MJPEG, bare ssh -R"}
MARKERS = "osv^Dx"
# By network, quality (None: adaptive) and way.
Summaries = Mapping[tuple[str, int | None, str], Summary]
# A member of Summary, what stands beside the axis, its scale.
Row = tuple[str, str, str]


def plots(summaries: Summaries) -> list[Plot]:
    """Both figures, where there is something of both axes to show."""
    if not any(quality is not None for _, quality, _ in summaries):
        return []
    video: Sequence[Row] = (
        ("mbit_s", "throughput of a robot, Mbit/s", "linear"),
        ("delay_mean_ms", "delay between frames, ms", "linear"),
    )
    late: Sequence[Row] = (
        ("age_p95_ms", "age of frames, p95, ms", "log"),
        ("command_p99_ms", "command latency, p99, ms", "log"),
    )
    return [
        Plot(
            name="operators-video",
            caption=(
                "Throughput of one robot's video (above) and mean delay between frames (below) by JPEG quality, one "
                "line a network, three robots at once; left ours, right plain MJPEG through a bare ssh -R."
            ),
            draw=partial(draw, summaries=summaries, rows=video),
        ),
        Plot(
            name="operators-age",
            caption=(
                "Age of the frames, p95 (above), and latency of commands meanwhile, p99 (below), by JPEG quality, "
                "one line a network, on logarithmic axes; left ours, right plain MJPEG through a bare ssh -R."
            ),
            draw=partial(draw, summaries=summaries, rows=late),
        ),
    ]


def draw(drawing: Drawing, *, summaries: Summaries, rows: Sequence[Row]) -> None:
    """Draw a row of two panels for each of `rows`, which share their axes."""
    drawing.set_size_inches(*SIZE_INCHES)
    panels = drawing.subplots(len(rows), 2, sharex=True, sharey="row", squeeze=False)
    for (name, label, scale), line in zip(rows, panels, strict=True):
        for axes, transport in zip(line, TITLES, strict=True):
            _draw_panel(axes, summaries, name, transport)
        for axes in line:
            _scale(axes, scale)
        line[0].set_ylabel(label)
    for axes, title in zip(panels[0], TITLES.values(), strict=True):
        axes.set_title(title)
    for axes in panels[-1]:
        axes.set(xlabel="JPEG quality", xticks=sorted(QUALITIES))
    drawing.legend(*panels[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=3)


def _scale(axes: Axes, scale: str) -> None:
    """Only when all that shares the axis is drawn, as its ends stay where they are then."""
    axes.set_yscale(scale)
    if scale == "linear":
        axes.set_ylim(bottom=0)
    else:
        # As plain numbers, where the usual ones are powers of ten.
        axes.yaxis.set_major_formatter(LogFormatter())
        axes.yaxis.set_minor_formatter(LogFormatter())


def _draw_panel(axes: Axes, summaries: Summaries, name: str, transport: str) -> None:
    for mark, (network, profile) in zip(MARKERS, NETWORKS.items(), strict=True):
        points = [
            (quality, value)
            for quality in sorted(QUALITIES)
            if (one := summaries.get((network, quality, transport))) is not None
            and (value := getattr(one, name)) is not None
        ]
        # Also without a point: each network has the same colour everywhere, and its place in the legend.
        axes.plot([x for x, _ in points], [y for _, y in points], marker=mark, label=profile.name)

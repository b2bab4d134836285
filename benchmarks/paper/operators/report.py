"""What the page says of the operators' experiment: a table a network, and where plain MJPEG is better. Pure."""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING

from matplotlib.ticker import LogFormatter
from numpy import quantile
from sections import NONE, Section, fixed
from sections import plain as plain_text

from paper.operators.run import (
    ADAPTIVE,
    FPS,
    LAST_S,
    NETWORKS,
    OURS,
    PLAIN,
    QUALITIES,
    ROBOTS,
    Run,
    Seen,
    step_name,
)
from paper.step import Comparison, Data, Plot, Report, Results, Scale, succeeded

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawing

SIZE_INCHES = (10.0, 7.5)
TITLES = {OURS: "Robotether", PLAIN: "plain MJPEG, bare ssh -R"}
MARKERS = "osv^Dx"
# A member of Summary, what stands beside the axis, its scale.
Row = tuple[str, str, str]
# The quality that is most for a link, and is compared in the page's first table.
COMPARED = 90
# A camera that gives less than this share of what it should is held up by the machine.
HELD_UP = 0.97
# Of the machine's processors: beyond it nothing comes at its time.
FULL = 0.95
# Columns that are members of Summary, with their decimals.
FIGURES = (
    ("frames/s", "pictures_per_s", 1),
    ("camera's own", "camera_fps", 1),
    ("width, pixels", "width_px", 0),
    ("KB a frame", "picture_kb", 1),
    ("Mbit/s a robot", "mbit_s", 2),
    ("delay between, mean, ms", "delay_mean_ms", 0),
    ("p95", "delay_p95_ms", 0),
    ("age p50, ms", "age_p50_ms", 0),
    ("p95", "age_p95_ms", 0),
    ("command p50, ms", "command_p50_ms", 1),
    ("p99", "command_p99_ms", 1),
)
COLUMNS = " | ".join(
    [
        *("quality", "transport"),
        *(column for column, _, _ in FIGURES),
        *("lost", "refused", "longest pause, ms", "simulator, % of a core", "machine busy, %"),
    ]
)
# A member of Summary in which the two ways are compared, what it is, its unit, and which is better.
MEASURES = (
    ("pictures_per_s", "frames a second", "frames/s", "higher"),
    ("width_px", "width of frames", "pixels", "higher"),
    ("delay_p95_ms", "delay between frames, p95", "ms", "lower"),
    ("age_p50_ms", "age of frames, p50", "ms", "lower"),
    ("age_p95_ms", "age of frames, p95", "ms", "lower"),
    ("command_p50_ms", "command latency, p50", "ms", "lower"),
    ("command_p99_ms", "command latency, p99", "ms", "lower"),
)
FIRST_TABLE = ("pictures_per_s", "age_p95_ms", "command_p99_ms")
# By network, quality (None: adaptive) and transport.
Runs = Mapping[tuple[str, int | None, str], Run]
Summaries = Mapping[tuple[str, int | None, str], "Summary"]


@dataclass(frozen=True, kw_only=True)
class Summary:
    """The figures of some robots; a rate is that of one robot, None is what nothing was measured of."""

    pictures_per_s: float
    camera_fps: float | None
    quality: float | None
    width_px: float | None
    picture_kb: float | None
    mbit_s: float
    delay_mean_ms: float | None
    delay_p95_ms: float | None
    age_p50_ms: float | None
    age_p95_ms: float | None
    commands: int
    # Commands that did not come while they were waited for; they are in no percentile.
    lost: int
    command_p50_ms: float | None
    command_p99_ms: float | None
    driven_per_s: float
    refused: int
    # The longest time without a command to the wheels.
    longest_pause_ms: float
    simulator_cpu: float
    agent_cpu: float


def summary(robots: Sequence[Seen], lasted_s: float) -> Summary:
    ages = [age for robot in robots for _, _, age in robot.pictures]
    sizes = [size for robot in robots for _, size, _ in robot.pictures]
    delays = [delay for robot in robots for delay in delays_ms(robot)]
    sent = [latency for robot in robots for latency in robot.commands_ms]
    received = [latency for latency in sent if latency is not None]
    each = len(robots) * lasted_s
    return Summary(
        pictures_per_s=len(sizes) / each,
        camera_fps=_mean(robot.camera_fps for robot in robots),
        quality=_mean(robot.quality for robot in robots),
        width_px=_mean(robot.width_px for robot in robots),
        picture_kb=sum(sizes) / len(sizes) / 1000 if sizes else None,
        mbit_s=sum(sizes) * 8 / each / 1e6,
        delay_mean_ms=_mean(delays),
        delay_p95_ms=_quantile(delays, 0.95),
        age_p50_ms=_quantile(ages, 0.5),
        age_p95_ms=_quantile(ages, 0.95),
        commands=len(sent),
        lost=len(sent) - len(received),
        command_p50_ms=_quantile(received, 0.5),
        command_p99_ms=_quantile(received, 0.99),
        driven_per_s=sum(len(robot.driven_ms) for robot in robots) / each,
        refused=sum(robot.refused for robot in robots),
        longest_pause_ms=max(longest_pause_ms(robot.driven_ms, lasted_s) for robot in robots),
        simulator_cpu=statistics.fmean(robot.simulator_cpu for robot in robots),
        agent_cpu=statistics.fmean(robot.agent_cpu for robot in robots),
    )


def delays_ms(robot: Seen) -> Iterator[float]:
    """The time from each frame to the next, in ms."""
    for (before, *_), (after, *_) in itertools.pairwise(robot.pictures):
        yield after - before


def longest_pause_ms(moments_ms: Sequence[float], lasted_s: float) -> float:
    """The longest time in which nothing came, in ms; the beginning and the end count as moments."""
    edges = [0.0, *sorted(moments_ms), lasted_s * 1000]
    return max(after - before for before, after in itertools.pairwise(edges))


def _mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return statistics.fmean(known) if known else None


def _quantile(values: Sequence[float], part: float) -> float | None:
    return quantile(values, part) if values else None


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


def report(_scale: Scale, results: Results) -> Report:
    """The page's part; what failed or has not run has no figures, and says so."""
    runs = measured_runs(results)
    summaries = {key: summary(run.robots, run.lasted_s) for key, run in runs.items()}
    return Report(
        sections=list(_sections(results, runs)),
        comparisons=list(_comparisons(summaries)),
        plots=plots(summaries),
        data=[_data(runs)] if runs else [],
        shortfalls=[*_machine(runs, summaries), *_worse(summaries)],
    )


def measured_runs(results: Results) -> Runs:
    """All runs of the steps that succeeded, in the plan's order."""
    good = succeeded(results)
    return {
        (network, quality, transport): Run.of(good[name][transport])
        for network in NETWORKS
        for quality in (*QUALITIES, ADAPTIVE)
        for transport in (OURS, PLAIN)
        if transport in good.get(name := step_name(network, quality), {})
    }


def _sections(results: Results, runs: Runs) -> Iterator[Section]:
    yield Section("How operators and robots were connected", _how(results))
    for network, profile in NETWORKS.items():
        rows = list(_rows(network, results, runs))
        if rows:
            text = (
                f"Each robot behind {profile.ping_ms:g} ms, {profile.down_mbit_s:g} Mbit/s down and "
                f"{profile.up_mbit_s:g} up."
            )
            yield Section(f"Video and commands: {profile.name}", text, COLUMNS, rows)


def _how(results: Results) -> str:
    good = len(succeeded(results))
    return (
        f"{ROBOTS} operators watch {ROBOTS} robots' cameras and drive them, all at once: {good} of {len(results)} "
        "steps that were run succeeded. Robots are simulated, with the real agent and guard, each behind a network of "
        f"its own. Operators are behind the first fixed line. A camera gives 640x480 pixels at {FPS} frames a second, "
        "and draws a timestamp into each. Our rows use the frames protocol with a single quality (`quality_min` equals "
        "`quality_max`): on a link that is too narrow, frames get smaller, as their width shows, or are skipped. The "
        'row "adaptive" has a viewer\'s default range of qualities; its quality is the mean of what the camera was '
        "asked for. The other rows are the paper's system, with the same robots just before or after: plain MJPEG and "
        "rosbridge through one bare `ssh -R` a robot, without TLS, logins, guard and relay, which all our figures "
        "include. The robots' TCP is cubic.\n\n"
        "Commands go at 20 Hz: a twist, and with it a numbered text that says when it was due. Command latency is from "
        f"then until the text is at the robot's own rosbridge. Lost is what had not come {LAST_S:g} s after the end; "
        "it is in no percentile. Refused is what the guard rejected because it was over 0.5 s old. The longest pause "
        "is the longest time without a twist. Percentiles are over all robots, rates are of one robot. \"Camera's "
        f"own\" is the camera's rate: less than {FPS} is this machine's limit, not the network's. Operators and "
        "recorders are one process on this machine."
    )


def _rows(network: str, results: Results, runs: Runs) -> Iterator[Sequence[object]]:
    for quality in (*QUALITIES, ADAPTIVE):
        name = step_name(network, quality)
        if name in results and results[name].values is None:
            yield _quality(quality), f"failed: {plain_text(results[name].failure)}", *[NONE] * 16
        for transport in (OURS, PLAIN):
            if run := runs.get((network, quality, transport)):
                yield _row(quality, transport, run)


def _row(quality: int | None, transport: str, run: Run) -> Sequence[object]:
    one = summary(run.robots, run.lasted_s)
    asked = f"adaptive: {fixed(one.quality, 0)}" if quality is ADAPTIVE else str(quality)
    figures = (fixed(getattr(one, name), digits) for _, name, digits in FIGURES)
    others = (one.longest_pause_ms, one.simulator_cpu * 100, run.busy * 100)
    lost = f"{one.lost} of {one.commands}"
    cells = (asked, TITLES[transport], *figures, lost, one.refused)
    return *cells, *(f"{value:.0f}" for value in others)


def _comparisons(summaries: Summaries) -> Iterator[Comparison]:
    for (network, quality), (ours, plain) in _pairs(summaries).items():
        for name, what, unit, better in MEASURES:
            values = (getattr(plain, name), getattr(ours, name))
            if quality == COMPARED and name in FIRST_TABLE and None not in values:
                yield Comparison(
                    what=f"{what}, quality {quality}, {NETWORKS[network].name}",
                    against=TITLES[PLAIN],
                    reference=values[0],
                    ours=values[1],
                    unit=unit,
                    better=better,
                )
    ours_all = [one for (_, _, transport), one in summaries.items() if transport == OURS]
    if ours_all:
        sent = sum(one.commands for one in ours_all)
        yield Comparison(
            what="commands that came while video went on",
            against="all sent",
            reference=sent,
            ours=sent - sum(one.lost for one in ours_all),
            unit="messages",
            better="equal",
        )


def _machine(runs: Runs, summaries: Summaries) -> Iterator[str]:
    """Whether the machine held up what was measured."""
    slow = {
        key: fps
        for key in runs
        if (fps := summaries[key].camera_fps) is not None and fps < HELD_UP * FPS
    }
    if slow:
        network, quality, transport = min(slow, key=slow.__getitem__)
        yield (
            f"This machine was a limit in {len(slow)} of {len(runs)} runs: the simulated cameras themselves gave "
            f"fewer than {HELD_UP * FPS:.1f} frames a second, at the least {slow[network, quality, transport]:.1f} "
            f"({_condition(network, quality)}, {TITLES[transport]})."
        )
    full = [key for key, run in runs.items() if run.busy > FULL]
    if full:
        yield (
            f"This machine was over {FULL:.0%} busy in {len(full)} of {len(runs)} runs: part of what is late or "
            "skipped there is its own, and no network's."
        )


def _worse(summaries: Summaries) -> Iterator[str]:
    """In which measures plain MJPEG is better, how often and by how much."""
    pairs = _pairs(summaries)
    for name, what, unit, better in MEASURES:
        worse = {}
        for key, (ours, plain) in pairs.items():
            one, other = getattr(ours, name), getattr(plain, name)
            if one is None:
                yield f"No {what}, {_condition(*key)}: too little came."
            elif other is not None and (one > other if better == "lower" else one < other):
                worse[key] = (one, other)
        if worse:
            key = max(worse, key=lambda key: _factor(*worse[key]))
            one, other = worse[key]
            yield (
                f"{what[0].upper()}{what[1:]}: worse than plain MJPEG and rosbridge through a bare "
                f"ssh -R in {len(worse)} of {len(pairs)} runs, at the most {one:.1f} beside {other:.1f} "
                f"{unit} ({_condition(*key)})."
            )


def _factor(one: float, other: float) -> float:
    low, high = sorted((one, other))
    return high / low if low else float("inf")


def _pairs(summaries: Summaries) -> dict[tuple[str, int | None], tuple[Summary, Summary]]:
    """Ours and plain of each network and quality that has both."""
    return {
        (network, quality): (summaries[network, quality, OURS], plain)
        for (network, quality, transport), plain in summaries.items()
        if transport == PLAIN and (network, quality, OURS) in summaries
    }


def _data(runs: Runs) -> Data:
    rows = [
        [network, _quality(quality), transport, number, run.lasted_s, run.busy, *figures]
        for (network, quality, transport), run in runs.items()
        for number, robot in enumerate(run.robots, 1)
        for figures in [asdict(summary([robot], run.lasted_s)).values()]
    ]
    return Data(
        name="operators-runs",
        about=(
            "three operators with video, one row a robot and run; rates and shares are of that robot alone, busy is "
            "this machine's; command latencies are of what came"
        ),
        header=(
            *("network", "quality", "way", "robot", "lasted_s", "busy"),
            *Summary.__dataclass_fields__,
        ),
        rows=[
            [round(cell, 4) if isinstance(cell, float) else cell for cell in row] for row in rows
        ],
    )


def _condition(network: str, quality: int | None) -> str:
    return (
        f"{NETWORKS[network].name}, {'adaptive' if quality is ADAPTIVE else f'quality {quality}'}"
    )


def _quality(quality: int | None) -> str:
    return "adaptive" if quality is ADAPTIVE else str(quality)

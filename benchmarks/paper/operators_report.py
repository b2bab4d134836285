"""What the page says of the operators' experiment: a table a network, and where plain MJPEG is better. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass

from sections import Section

from paper.operators_plan import ADAPTIVE, FPS, NETWORKS, OURS, PLAIN, QUALITIES, ROBOTS, step_name
from paper.operators_plots import plots
from paper.operators_run import LAST_S
from paper.operators_values import Run, Summary, summary
from paper.step import Comparison, Data, Report, Results, Scale, succeeded
from paper.words import plain as plain_text

NONE = "-"
NAMES = {OURS: "Robotether", PLAIN: "plain MJPEG, bare ssh -R"}
# The quality that is most for a link, and is compared in the page's first table.
COMPARED = 90
# A camera that gives less than this share of what it should is held up by the machine.
HELD_UP = 0.97
# Of the machine's processors: beyond it nothing comes at its time.
FULL = 0.95
HEADER = (
    "| quality | transport | frames/s | camera's own | width, pixels | KB a frame | Mbit/s a robot "
    "| delay between, mean, ms | p95 "
    "| age p50, ms | p95 | command p50, ms | p99 | lost | refused | longest pause, ms | simulator, % of a core "
    "| machine busy, % |"
)

# By network, quality (None: adaptive) and way.
Runs = Mapping[tuple[str, int | None, str], Run]


@dataclass(frozen=True)
class Measure:
    """A figure in which the two ways are compared."""

    name: str
    what: str
    unit: str
    better: str


MEASURES = (
    Measure("pictures_per_s", "frames a second", "frames/s", "higher"),
    Measure("width_px", "width of frames", "pixels", "higher"),
    Measure("delay_p95_ms", "delay between frames, p95", "ms", "lower"),
    Measure("age_p50_ms", "age of frames, p50", "ms", "lower"),
    Measure("age_p95_ms", "age of frames, p95", "ms", "lower"),
    Measure("command_p50_ms", "command latency, p50", "ms", "lower"),
    Measure("command_p99_ms", "command latency, p99", "ms", "lower"),
)
FIRST_TABLE = ("pictures_per_s", "age_p95_ms", "command_p99_ms")


def report(_scale: Scale, results: Results) -> Report:
    """The page's part; what failed or has not run has no figures, and says so."""
    runs = measured_runs(results)
    summaries = {key: run.summary for key, run in runs.items()}
    return Report(
        sections=list(_sections(results, runs)),
        comparisons=list(_comparisons(summaries)),
        plots=plots(summaries),
        data=[_data(runs)] if runs else [],
        shortfalls=[*_machine(runs), *_worse(summaries)],
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
    yield Section("How operators and robots were connected", _how(results), [])
    for network, profile in NETWORKS.items():
        rows = list(_rows(network, results, runs))
        if rows:
            text = (
                f"Each robot behind {profile.ping_ms:g} ms, {profile.down_mbit_s:g} Mbit/s down and "
                f"{profile.up_mbit_s:g} up."
            )
            table = [HEADER, "|---" * HEADER.count(" | ") + "|---|", *rows]
            yield Section(f"Video and commands: {profile.name}", text, table)


def _how(results: Results) -> str:
    good = len(succeeded(results))
    return (
        f"{ROBOTS} operators watch {ROBOTS} robots' cameras and drive them, all at once: {good} of "
        f"{len(results)} steps that were run succeeded. The robots are simulated ones with the real agent "
        "and guard, each behind a network of its own. Each operator is behind the first fixed line. A "
        f"camera gives 640x480 pixels at {FPS} frames a second, and draws a timestamp into each. Our rows "
        "use the frames protocol with a single quality (`quality_min` equals `quality_max`): on a link "
        "that is too narrow, frames get smaller, as their width shows, or are skipped. One row, "
        '"adaptive", has a viewer\'s default range of qualities; its quality is the mean of what the '
        "camera was asked for. The other rows are the paper's system, with the same robots just before or "
        "after: plain MJPEG and rosbridge through one bare `ssh -R` a robot, without TLS, logins, guard "
        "and relay, which all our figures include. The robots' TCP is cubic.\n\n"
        "Commands go at 20 Hz: a twist, and with it a numbered text that says when it was due. Command "
        "latency is from then until the text is at the robot's own rosbridge. Lost is what had not come "
        f"{LAST_S:g} s after the end; it is in no percentile. Refused is what the guard rejected because "
        "it was over 0.5 s old. The longest pause is the longest time without a twist. Percentiles are "
        "over all robots, rates are of one robot. \"Camera's own\" is the camera's rate, by the frames' "
        f"sequence numbers or by a viewer on the robot itself: less than {FPS} is this machine's limit, "
        "not the network's. Operators and recorders are one process on this machine."
    )


def _rows(network: str, results: Results, runs: Runs) -> Iterator[str]:
    for quality in (*QUALITIES, ADAPTIVE):
        name = step_name(network, quality)
        if name in results and results[name].values is None:
            yield f"| {_quality(quality)} | failed: {plain_text(results[name].failure)} {'| ' * 16}|"
        for transport in (OURS, PLAIN):
            if run := runs.get((network, quality, transport)):
                yield _row(quality, transport, run)


def _row(quality: int | None, transport: str, run: Run) -> str:
    one = run.summary
    asked = f"adaptive: {_said(one.quality, 0)}" if quality is ADAPTIVE else str(quality)
    cells = (
        asked,
        NAMES[transport],
        _said(one.pictures_per_s, 1),
        _said(one.camera_fps, 1),
        _said(one.width_px, 0),
        _said(one.picture_kb, 1),
        _said(one.mbit_s, 2),
        _said(one.delay_mean_ms, 0),
        _said(one.delay_p95_ms, 0),
        _said(one.age_p50_ms, 0),
        _said(one.age_p95_ms, 0),
        _said(one.command_p50_ms, 1),
        _said(one.command_p99_ms, 1),
        f"{one.lost} of {one.commands}",
        str(one.refused),
        _said(one.longest_pause_ms, 0),
        _said(one.simulator_cpu * 100, 0),
        _said(run.busy * 100, 0),
    )
    return f"| {' | '.join(cells)} |"


def _comparisons(summaries: Mapping[tuple[str, int | None, str], Summary]) -> Iterator[Comparison]:
    for (network, quality), (ours, plain) in _pairs(summaries).items():
        for measure in MEASURES:
            values = (getattr(plain, measure.name), getattr(ours, measure.name))
            if quality == COMPARED and measure.name in FIRST_TABLE and None not in values:
                yield Comparison(
                    what=f"{measure.what}, quality {quality}, {NETWORKS[network].name}",
                    against=NAMES[PLAIN],
                    reference=values[0],
                    ours=values[1],
                    unit=measure.unit,
                    better=measure.better,
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


def _machine(runs: Runs) -> Iterator[str]:
    """Whether the machine held up what was measured."""
    slow = {
        key: fps
        for key, run in runs.items()
        if (fps := run.summary.camera_fps) is not None and fps < HELD_UP * FPS
    }
    if slow:
        network, quality, transport = min(slow, key=slow.__getitem__)
        yield (
            f"This machine was a limit in {len(slow)} of {len(runs)} runs: the simulated cameras themselves gave "
            f"fewer than {HELD_UP * FPS:.1f} frames a second, at the least {slow[network, quality, transport]:.1f} "
            f"({_condition(network, quality)}, {NAMES[transport]})."
        )
    full = [key for key, run in runs.items() if run.busy > FULL]
    if full:
        yield (
            f"This machine was over {FULL:.0%} busy in {len(full)} of {len(runs)} runs: part of what is late or "
            "skipped there is its own, and no network's."
        )


def _worse(summaries: Mapping[tuple[str, int | None, str], Summary]) -> Iterator[str]:
    """In which measures plain MJPEG is better, how often and by how much."""
    pairs = _pairs(summaries)
    for measure in MEASURES:
        worse = {}
        for key, (ours, plain) in pairs.items():
            one, other = getattr(ours, measure.name), getattr(plain, measure.name)
            if one is None:
                yield f"No {measure.what}, {_condition(*key)}: too little came."
            elif other is not None and (one > other if measure.better == "lower" else one < other):
                worse[key] = (one, other)
        if worse:
            key = max(worse, key=lambda key: _factor(*worse[key]))
            one, other = worse[key]
            yield (
                f"{measure.what[0].upper()}{measure.what[1:]}: worse than plain MJPEG and rosbridge through a bare "
                f"ssh -R in {len(worse)} of {len(pairs)} runs, at the most {one:.1f} beside {other:.1f} "
                f"{measure.unit} ({_condition(*key)})."
            )


def _factor(one: float, other: float) -> float:
    low, high = sorted((one, other))
    return high / low if low else float("inf")


def _pairs(
    summaries: Mapping[tuple[str, int | None, str], Summary],
) -> dict[tuple[str, int | None], tuple[Summary, Summary]]:
    """Ours and plain of each network and quality that has both."""
    return {
        (network, quality): (summaries[network, quality, OURS], plain)
        for (network, quality, transport), plain in summaries.items()
        if transport == PLAIN and (network, quality, OURS) in summaries
    }


def _data(runs: Runs) -> Data:
    rows = []
    for (network, quality, transport), run in runs.items():
        for number, robot in enumerate(run.robots, 1):
            figures = asdict(summary([robot], run.lasted_s))
            # What the results have for each robot, and the machine for all of them.
            rows.append(
                [
                    network,
                    _quality(quality),
                    transport,
                    number,
                    run.lasted_s,
                    run.busy,
                    *figures.values(),
                ]
            )
    return Data(
        name="operators-runs",
        about=(
            "three operators with video, one row a robot and run; rates and shares are of that robot alone, busy is "
            "this machine's; command latencies are of what came"
        ),
        header=(
            "network",
            "quality",
            "way",
            "robot",
            "lasted_s",
            "busy",
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


def _said(value: float | None, digits: int) -> str:
    return NONE if value is None else f"{value:.{digits}f}"

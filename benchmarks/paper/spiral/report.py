"""The rows of the spirals: where they ended, and where their spread comes from. Pure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from report import NONE, Figure, Row, quantiles
from sim_robot.kinematics import STANDING, STEP_S, Velocity

from paper.spiral import course
from paper.spiral.course import (
    LENGTH_M,
    NETWORKS,
    PAPER_SIGMA_X_M,
    PAPER_SIGMA_Y_M,
    PAPERS,
    Change,
    Plan,
    commanded_m,
    end_of,
    punctual,
    stepped_ends,
)
from paper.step import Comparison, Report, Results, exactly, succeeded

# How many of the runs that failed are told.
MAX_REPORTED = 3
# A standard deviation of fewer says nothing.
FEWEST = 2


def runs_of(results: Results, wanted: Sequence[Velocity]) -> pd.DataFrame:
    """A row for each run of the drives that succeeded, as spiral.outcome made it; x and y of its end in m.

    arrivals_x and arrivals_y are the end of a robot without steps that follows the run's commands as they arrived.
    """
    runs = pd.DataFrame(
        [
            {"repetition": values["repetition"], **pair, **_ends(pair, wanted)}
            for values in succeeded(results).values()
            for pair in values["pairs"]
        ],
        columns=[
            *("repetition", "network", "pair", "failure", "sent_ms", "arrived_ms", "steps"),
            *("travelled_m", "x", "y", "arrivals_x", "arrivals_y"),
        ],
    )
    return runs.astype(dict.fromkeys(("x", "y", "arrivals_x", "arrivals_y"), float))


def _ends(pair: Row, wanted: Sequence[Velocity]) -> Row:
    ends: dict[str, float] = {}
    if pair["end"] is not None:
        ends["x"], ends["y"], _ = pair["end"]
    if not pair["failure"]:
        commands = zip(pair["arrived_ms"], [*wanted, STANDING], strict=True)
        there = end_of([Change(at_ms / 1000, velocity) for at_ms, velocity in commands])
        ends |= {"arrivals_x": there.x, "arrivals_y": there.y}
    return ends


def completed(runs: pd.DataFrame) -> pd.DataFrame:
    return runs[runs.failure == ""]


def of_commonest_steps(runs: pd.DataFrame) -> pd.DataFrame:
    """Those of the completed runs that took the number of steps that most of them took."""
    done = completed(runs)
    return done[done.steps.isin(done.steps.mode()[:1])]


def report(plan: Plan, results: Results) -> Report:
    """The page's part; of drives that failed or have not run there are none of the runs."""
    runs = runs_of(results, plan.wanted)
    by_network = {network: runs[runs.network == network] for network in NETWORKS}
    return Report(
        values={
            "course": course,
            "plan": plan,
            "commanded_m": f"{commanded_m(plan.wanted):.3f}",
            "ran": len(succeeded(results)),
            "step_ms": f"{STEP_S * 1000:g}",
            "steps": punctual(plan.wanted)[-1].at_s / STEP_S,
            "apart_mm": f"{plan.wanted[-1].linear_x * STEP_S * 1000:.0f}",
            "ends": _end_rows(plan, by_network),
            "causes": _cause_rows(plan, by_network),
        },
        comparisons=[row for one in by_network.items() for row in _comparisons(plan, *one)],
        shortfalls=[
            line
            for network, some in by_network.items()
            for line in (_failed(network, some), _explained(plan, network, some))
            if line
        ],
        figure=_figure(plan, completed(runs)),
    )


def _end_rows(plan: Plan, by_network: dict[str, pd.DataFrame]) -> list[Row]:
    ideal = end_of(punctual(plan.wanted))
    rows: list[Row] = []
    for network, runs in by_network.items():
        done = completed(runs)
        off_mm = 1000 * np.hypot(done.x - ideal.x, done.y - ideal.y)
        off = quantiles(off_mm, 0.5, 1, unit="mm")
        travelled = done.travelled_m.astype(float)
        rows.append(
            {
                "network": NETWORKS[network].name,
                "completed": f"{len(done)} of {plan.runs}",
                "sigma of x, m": f"{done.x.std():.4f}",
                "sigma of y, m": f"{done.y.std():.4f}",
                **{f"off the ideal end, {name}": mm for name, mm in off.items()},
                **{
                    f"travelled, m: {name}": f"{getattr(travelled, name)():.3f}"
                    for name in ("min", "mean", "max")
                },
            }
        )
    papers = {"sigma of x, m": f"{PAPER_SIGMA_X_M:.3f}", "sigma of y, m": f"{PAPER_SIGMA_Y_M:.3f}"}
    paper = {"network": "the paper", "completed": "50 of 50", **papers}
    return [*rows, {**paper, "travelled, m: mean": f"{LENGTH_M:.3f}"}]


def _cause_rows(plan: Plan, by_network: dict[str, pd.DataFrame]) -> list[Row]:
    rows: list[Row] = []
    for network, runs in by_network.items():
        done, alike = completed(runs), of_commonest_steps(runs)
        sent = pd.DataFrame(list(done.sent_ms), dtype=float)
        arrived = pd.DataFrame(list(done.arrived_ms), dtype=float)
        rows.append(
            {
                "network": NETWORKS[network].name,
                "driven, mm": _sigmas_mm(done[["x", "y"]]),
                "same number of steps, mm": f"{_sigmas_mm(alike[['x', 'y']])} ({len(alike)} runs)",
                "arrivals alone, mm": _sigmas_mm(done[["arrivals_x", "arrivals_y"]]),
                "sigma between sendings, ms": sent.diff(axis=1).stack().std(),
                "sigma between arrivals, ms": arrived.diff(axis=1).stack().std(),
                **{
                    f"on the way, {name}": ms
                    for name, ms in quantiles(
                        (arrived - sent).stack(), 0.5, 0.99, unit="ms"
                    ).items()
                },
            }
        )
    floor = {"driven, mm": _sigmas_mm(_stepped(plan)), "arrivals alone, mm": "0.0 / 0.0"}
    return [*rows, {"network": "exact intervals", **floor}]


def _stepped(plan: Plan) -> pd.DataFrame:
    return pd.DataFrame([(end.x, end.y) for end in stepped_ends(plan.wanted)])


def _sigmas_mm(ends: pd.DataFrame) -> str:
    if len(ends.dropna()) < FEWEST:
        return NONE
    return " / ".join(f"{1000 * sigma:.1f}" for sigma in ends.std())


def _figure(plan: Plan, done: pd.DataFrame) -> Figure:
    """Ends that a picture could not tell apart are one."""
    ideal = end_of(punctual(plan.wanted))
    points = pd.DataFrame(
        {
            "line": [NETWORKS[network].name for network in done.network],
            "x": (1000 * (done.x - ideal.x)).round(),
            "y": (1000 * (done.y - ideal.y)).round(),
        }
    )
    return Figure(
        caption="Where the robots stood, seen from the ideal end.",
        lines=[points.drop_duplicates()] if len(points) else [],
        x="x from the ideal end, mm",
        y="y from the ideal end, mm",
        style="o",
    )


def _comparisons(plan: Plan, network: str, runs: pd.DataFrame) -> list[Comparison]:
    name, done = NETWORKS[network].name, completed(runs)
    against = "paper" if network in PAPERS else "all"
    driven = f"spirals driven to the end, {name}"
    rows = [exactly(driven, against, 100.0, 100.0 * len(done) / plan.runs, "%")]
    if network in PAPERS and plan.is_whole and len(done) >= FEWEST:
        rows += [
            Comparison(
                f"spiral, sigma of the final {axis}, {name}", "paper", papers, ours, "m", "lower"
            )
            for axis, papers, ours in (
                ("x", PAPER_SIGMA_X_M, done.x.std()),
                ("y", PAPER_SIGMA_Y_M, done.y.std()),
            )
        ]
    return rows


def _failed(network: str, runs: pd.DataFrame) -> str:
    """A sentence on those that were not driven to their ends; empty when all were."""
    lost = runs[runs.failure != ""]
    if lost.empty:
        return ""
    reported = [
        f"repetition {run.repetition}, pair {run.pair}: {run.failure}"
        for run in lost[:MAX_REPORTED].itertuples()
    ]
    more = f"; and {len(lost) - MAX_REPORTED} more" if len(lost) > MAX_REPORTED else ""
    return (
        f"{len(lost)} of {len(runs)} spirals on {NETWORKS[network].name} were not driven to the end: "
        f"{'; '.join(reported)}{more}."
    )


def _explained(plan: Plan, network: str, runs: pd.DataFrame) -> str:
    """Why the ends spread more than the paper's, where they do."""
    ours, floor = completed(runs)[["x", "y"]].std(), _stepped(plan).std()
    is_more = ours.x > PAPER_SIGMA_X_M or ours.y > PAPER_SIGMA_Y_M
    if not (network in PAPERS and plan.is_whole and is_more):
        return ""
    return (
        f"The spirals' ends on {NETWORKS[network].name} spread by {ours.x:.3f} m in x and {ours.y:.3f} m in y, the "
        f"paper's by {PAPER_SIGMA_X_M:.3f} m and {PAPER_SIGMA_Y_M:.3f} m. Of commands at exact intervals turtlesim's "
        f"steps alone make {floor[0]:.3f} m and {floor[1]:.3f} m, unless all runs take the same number of them."
    )

"""`make experiments`: a machine's limits, and cells that break, measured against a stack of its own.

A step that raises has failed, and the others run all the same; a part's page is written when its steps have run, in
docs once all of them have.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import platform
import re
import signal
import statistics
import subprocess
import sys
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from demo import ROOT
from openssh_server import wait_until
from report import cell, commit, duration, machine, page, plain

from paper.cells import cells
from paper.density import density
from paper.requests import requests
from paper.step import Outcome, Part, Report, Scale, Step, Values, now
from paper.world import World

LONGEST_FAILURE = 300


@dataclass(frozen=True, kw_only=True)
class Chapter:
    part: Part
    # By the steps' names.
    outcomes: Mapping[str, Outcome]
    report: Report

    @property
    def failed(self) -> list[Outcome]:
        return [outcome for outcome in self.outcomes.values() if outcome.values is None]

    @property
    def failures(self) -> list[str]:
        return [f"{plain(step.title)}: {plain(step.failure)}" for step in self.failed]

    @property
    def faults(self) -> list[str]:
        """All that makes a run fail: steps that failed, and what has to be equal and is not."""
        return [
            *(f"{step.title}: {step.failure}" for step in self.failed),
            *(
                f"{row.what} is {cell(row.ours)} and has to be {cell(row.reference)} {row.unit}"
                for row in self.report.comparisons
                if row.better == "equal" and row.is_short
            ),
        ]

    @property
    def took_s(self) -> float:
        return sum(outcome.took_s for outcome in self.outcomes.values())


def sentence(error: BaseException) -> str:
    """An exception in one line: its kind and what it says; of a group, those that it holds."""
    if isinstance(error, BaseExceptionGroup):  # noqa: F821 (ruff checks for 3.10; this runs from 3.11 on)
        return "; ".join(sentence(problem) for problem in error.exceptions)
    said = " ".join(str(error).split())
    if len(said) > LONGEST_FAILURE:
        said = f"{said[:LONGEST_FAILURE]}..."
    return f"{type(error).__name__}: {said}" if said else type(error).__name__


def write_page(folder: Path, item: Chapter, scale: Scale, where: Sequence[str]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    written = folder / f"{item.part.name}.md"
    name = item.part.name if item.report.values else "experiment"
    outcomes = item.outcomes.values()
    loads, times = ([step.load for step in outcomes], [step.began for step in outcomes])
    circumstances = [
        *map(plain, where),
        f"Date: {min(times)} to {max(times)}; the {len(times)} steps took {duration(item.took_s)}.",
        f"Load when a step began: median {statistics.median(loads):.1f}, most {max(loads):.1f}.",
    ]
    values = {"one": item, "scale": scale, "circumstances": circumstances, **item.report.values}
    written.write_text(page(f"{name}.md.j2", **values))
    return written


PARTS = {part.name: part for part in (density.PART, cells.PART, requests.PART)}
ARTIFACTS = ROOT / "tests" / "artifacts"
SAMPLES, TRIAL_PAGES = ARTIFACTS / "experiments", ARTIFACTS / "experiments-quick"
PAGES = ROOT / "docs" / "experiments"
# A path that nginx, web and the database take part in, and that costs the same however many robots there are.
CHEAP_PATH = "/me"
# A step may end while the services that it has restarted come back.
ANSWERS_WITHIN_S, ASK_AGAIN_S = 60.0, 0.5
# Service, what its daemon is called, and the command that tells its version.
DAEMONS = (
    ("nginx", "nginx", "nginx -v"),
    ("sshd", "OpenSSH", "ssh -V"),
    ("mysql", "MariaDB", "mariadbd --version"),
    ("relay", "Python of web and relay", "python3 --version"),
)
_VERSION = re.compile(r"\d+\.\d[\w.]*")


def circumstances(world: World) -> Iterator[str]:
    here = machine()
    yield (
        f"Machine: {here['processor']}, {here['cores']} cores, {here['memory_gb']} GB of memory, "
        f"Linux {here['kernel']}; everything runs on it."
    )
    # Most daemons tell their versions on stderr.
    texts = {name: world.exec(service, "sh", "-c", f"{ask} 2>&1") for service, name, ask in DAEMONS}
    client = subprocess.run(["ssh", "-V"], capture_output=True, text=True, check=True).stderr
    texts["OpenSSH of the robots"] = client
    texts["Python of robots and experiments"] = platform.python_version()
    texts["Docker"] = str(world.engine.version()["Version"])
    versions = (f"{name} {(_VERSION.findall(text) or [text])[0]}" for name, text in texts.items())
    yield f"Versions: {', '.join(versions)}."
    yield f"Commit: {commit()}."


def answers(world: World) -> bool:
    try:
        world.ask("GET", CHEAP_PATH)
    except OSError:
        return False
    return True


def run_step(step: Step, world: World) -> Outcome:
    began, load, start = now(), os.getloadavg()[0], time.monotonic()
    values: Values | None = None
    failure = ""
    try:
        what = "the stack answers"
        wait_until(lambda: answers(world), lambda: what, ANSWERS_WITHIN_S, ASK_AGAIN_S)
        values = step.run(world)
    # Also a task that was cancelled by nobody's Ctrl-C.
    except (Exception, asyncio.CancelledError) as error:  # noqa: BLE001 (the border of a step)
        traceback.print_exc()
        failure = sentence(error)
    return Outcome(
        title=step.title,
        values=values,
        failure=failure,
        took_s=time.monotonic() - start,
        load=load,
        began=began,
    )


def chosen(names: Sequence[str], scale: Scale) -> Mapping[str, Sequence[Step]]:
    """The steps that run, by part: all without a name, those of a part, or one, PART-STEP; raises ValueError."""
    steps = {name: part.steps(scale) for name, part in PARTS.items()}
    known = {*PARTS, *(f"{part}-{step.name}" for part, all_of in steps.items() for step in all_of)}
    if unknown := set(names) - known:
        raise ValueError(
            f"there is no {', '.join(sorted(unknown))}, but {', '.join(sorted(known))}"
        )
    asked = {
        part: [step for step in all_of if not names or {part, f"{part}-{step.name}"} & set(names)]
        for part, all_of in steps.items()
    }
    return {part: some for part, some in asked.items() if some}


def run_part(part: Part, steps: Sequence[Step], world: World) -> Chapter:
    outcomes = {}
    for step in steps:
        sys.stderr.write(f"experiments: {part.name}: {step.title}\n")
        outcomes[step.name] = run_step(step, world)
    SAMPLES.mkdir(parents=True, exist_ok=True)
    samples = {name: asdict(outcome) for name, outcome in outcomes.items()}
    (SAMPLES / f"{part.name}.json").write_text(json.dumps(samples))
    values = {name: step.values for name, step in outcomes.items() if step.values is not None}
    return Chapter(part=part, outcomes=outcomes, report=part.report(values))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="+", default=[], help="these parts, or steps: PART-STEP")
    parser.add_argument("--quick", action="store_true", help="all small, which no page of docs has")
    parser.add_argument("--full", action="store_true", help="what lasts, for longer")
    arguments = parser.parse_args()
    scale = Scale(quick=arguments.quick, full=arguments.full)
    try:
        asked = chosen(arguments.only, scale)
    except ValueError as error:
        parser.error(str(error))
    # It ends as by Ctrl-C, with the stack, all robots and rows.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    faults = []
    with World.own() as world:
        where = list(circumstances(world))
        for name, steps in asked.items():
            done = run_part(PARTS[name], steps, world)
            is_whole = not scale.quick and len(steps) == len(PARTS[name].steps(scale))
            page = write_page(PAGES if is_whole else TRIAL_PAGES, done, scale, where)
            faults += done.faults
            lines = [f"{len(done.failed)} of {len(done.outcomes)} steps failed", *done.faults]
            sys.stdout.write("\n  ".join([f"{name}: a page is {page}", *lines]) + "\n")
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main())

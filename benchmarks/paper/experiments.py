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
import subprocess
import sys
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict

from demo import ROOT
from openssh_server import wait_until
from report import commit, machine

from paper.cells import cells
from paper.density import density
from paper.page import Chapter, chapter, sentence, write_page
from paper.requests import requests
from paper.step import Outcome, Part, Scale, Step, Values, now
from paper.world import World

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
    return chapter(part, outcomes)


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

"""`make bench`: runs the experiments one after the other and writes docs/measurements.md.

Needs `make demo` and root, as some of them make networks of their own. `--only NAME` runs one and prints it without
writing the page; `--quick` repeats less, to see that all of them work, and writes nothing either; `--repeat N` repeats
cuts and losses so often, which the tables show. No figure is carried over from an older run.
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import behind_video
import guard_latency
import operations_rate
import recovery
import round_trip
import stopping
from demo import ROOT, Demo
from sections import Section

PAGE = ROOT / "docs" / "measurements.md"


@dataclass(frozen=True)
class Effort:
    """How much is measured."""

    quick: bool
    repeat: int | None

    def times(self, usual: int, quick: int) -> int:
        """How often a cut or a loss is repeated."""
        return quick if self.quick else self.repeat or usual


EXPERIMENTS: Mapping[str, Callable[[Demo, Effort], Section]] = {
    "round_trip": lambda demo, effort: round_trip.measure(demo, 200 if effort.quick else 3000),
    "behind_video": lambda _, effort: behind_video.measure(5 if effort.quick else behind_video.SECONDS),
    "recovery": lambda _, effort: recovery.measure(effort.times(recovery.REPEAT, 2)),
    "stopping": lambda demo, effort: stopping.measure(demo, effort.times(10, 1)),
    "operations_rate": lambda _demo, _effort: operations_rate.measure(),
    "guard_latency": lambda _, effort: guard_latency.measure(200 if effort.quick else 2000),
}  # fmt: skip


def heading() -> str:
    """When, at which commit and on what it was measured."""
    commit = subprocess.run(
        ["git", "describe", "--always", "--dirty"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.strip()
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    cpu = names[0] if names else platform.machine()
    return f"""# Measurements

Written by `make bench` on {datetime.now(UTC):%Y-%m-%d} at commit {commit}; {cpu}, {os.cpu_count()} cores,
everything on this one machine, Linux {platform.release().split("-")[0]}, Python {platform.python_version()}.
Compare within a table, not between runs.
"""


def main() -> None:
    """Measure, print, write."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--only", choices=EXPERIMENTS, help="run this one, and write nothing")
    arguments.add_argument("--quick", action="store_true", help="repeat less, and write nothing")
    arguments.add_argument("--repeat", type=int, help="how often cuts and losses are repeated")
    chosen = arguments.parse_args()
    demo, effort = Demo(), Effort(chosen.quick, chosen.repeat)
    names = [chosen.only] if chosen.only else list(EXPERIMENTS)
    sections = []
    for name in names:
        sys.stderr.write(f"bench: {name}\n")
        section = EXPERIMENTS[name](demo, effort)
        sys.stdout.write(section.markdown + "\n")
        sys.stdout.flush()
        sections.append(section)
    if not (chosen.only or chosen.quick):
        PAGE.write_text("\n".join([heading(), *(section.markdown for section in sections)]))


if __name__ == "__main__":
    main()

"""`make bench`: runs the experiments one after the other and writes docs/measurements.md.

Needs `make demo`, and root for the networks that some experiments create. `--only NAME,...` runs these alone and
replaces their parts of the page. `--quick` repeats less, to check that all of them work, and writes nothing.
`--repeat N` is how often cuts and losses are repeated.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime

import agent_memory
import behind_video
import drive_page
import guard_latency
import input_latency
import operations_rate
import picture_age
import recovery
import round_trip
import stopping
import viewers
from demo import ROOT, Demo
from measurements_page import page, parts
from paper.circumstances import described, machine
from sections import Section, wrapped

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
    "picture_age": lambda demo, effort: picture_age.measure(demo, 3 if effort.quick else picture_age.SECONDS),
    "viewers": lambda demo, effort: viewers.measure(demo, 3 if effort.quick else viewers.SECONDS),
    "input_latency": lambda demo, effort: input_latency.measure(demo, 5 if effort.quick else input_latency.PRESSES),
    "drive_page": lambda demo, effort: drive_page.measure(demo, 3 if effort.quick else drive_page.SECONDS),
    "recovery": lambda _, effort: recovery.measure(effort.times(recovery.REPEAT, 2)),
    "stopping": lambda demo, effort: stopping.measure(demo, effort.times(10, 1)),
    "operations_rate": lambda _demo, _effort: operations_rate.measure(),
    "agent_memory": lambda _demo, _effort: agent_memory.measure(),
    "guard_latency": lambda _, effort: guard_latency.measure(200 if effort.quick else 2000),
}  # fmt: skip


def circumstances() -> str:
    """When, at which commit, on what machine and at what load; call it before the measurement."""
    here = machine()
    return wrapped(
        f"Measured on {datetime.now(UTC):%Y-%m-%d} at commit {described()}, all on one machine: "
        f"{here['processor']}, {here['cores']} cores, Linux {here['kernel']}, Python "
        f"{platform.python_version()}, load {os.getloadavg()[0]:.1f} at the start."
    )


def names_of(text: str) -> list[str]:
    """The experiments that `--only` names, in the page's order."""
    chosen = text.split(",")
    for name in chosen:
        if name not in EXPERIMENTS:
            known = ", ".join(EXPERIMENTS)
            raise argparse.ArgumentTypeError(f"there is no experiment {name}; there are {known}")
    return [name for name in EXPERIMENTS if name in chosen]


def write_part(name: str, section: Section, measured: str) -> None:
    """Write a part to the page at once: a later experiment may fail."""
    known = parts(PAGE.read_text()) if PAGE.exists() else {}
    known[name] = f"{section.markdown}\n{measured}"
    PAGE.write_text(page(known, EXPERIMENTS))


def main() -> None:
    """Measure, print, write."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument(
        "--only", type=names_of, default=list(EXPERIMENTS), help="run these, separated by commas"
    )
    arguments.add_argument("--quick", action="store_true", help="repeat less, write nothing")
    arguments.add_argument("--repeat", type=int, help="how often cuts and losses are repeated")
    chosen = arguments.parse_args()
    demo, effort = Demo(), Effort(chosen.quick, chosen.repeat)
    for name in chosen.only:
        sys.stderr.write(f"bench: {name}\n")
        measured = circumstances()
        section = EXPERIMENTS[name](demo, effort)
        sys.stdout.write(section.markdown + "\n")
        sys.stdout.flush()
        if not chosen.quick:
            write_part(name, section, measured)


if __name__ == "__main__":
    main()

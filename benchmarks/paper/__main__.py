"""`make experiments`: runs the paper's experiments against a stack of its own and writes docs/experiments/.

A run that was interrupted goes on where it was when it is started again; a finished one starts anew, and what it had
measured is moved away. The exit status is 1 when a step has failed, something is missing, or a figure that has to be
met exactly is not; the page is written before.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Mapping, Sequence

from paper import high_rate, mixed, operators, peers, spiral, startup
from paper.circumstances import ROOT
from paper.page import Chapter, chapter
from paper.page_files import write_page
from paper.runner import StackGoneError, run_parts
from paper.step import Part, Scale
from paper.store import ResultStore, StoreBusyError
from paper.words import number

# All experiments, in the page's order.
PARTS = (startup.PART, high_rate.PART, mixed.PART, spiral.PART, operators.PART, peers.PART)
NAMES = tuple(part.name for part in PARTS)
ARTIFACTS = ROOT / "tests" / "artifacts"
STORES = ARTIFACTS / "experiments"
PAGE, QUICK_PAGE = ROOT / "docs" / "experiments", ARTIFACTS / "experiments-quick"
FAILED, INTERRUPTED = 1, 130
GO_ON = "interrupted; the step that ran is left out, and the same command goes on where it was"


def names_of(text: str) -> list[str]:
    """The parts that `--only` names, in the page's order."""
    chosen = text.split(",")
    for name in chosen:
        if name not in NAMES:
            raise argparse.ArgumentTypeError(
                f"there is no experiment {name}; there are {', '.join(NAMES)}"
            )
    return [name for name in NAMES if name in chosen]


def arguments(words: Sequence[str] | None = None) -> argparse.Namespace:
    """What was asked for."""
    parser = argparse.ArgumentParser(prog="python -m paper", description=__doc__)
    add = parser.add_argument
    scale = parser.add_mutually_exclusive_group()
    scale.add_argument(
        "--quick", action="store_true", help="all of it small; the page goes to tests/artifacts"
    )
    scale.add_argument("--full", action="store_true", help="the paper's 1000 repetitions")
    parts = f"run these: {', '.join(NAMES)}"
    add("--only", type=names_of, default=list(NAMES), metavar="PART,...", help=parts)
    add("--restart", action="store_true", help="measure anew what an earlier run has measured")
    add("--page-only", action="store_true", help="run nothing; write the page of what was measured")
    return parser.parse_args(words)


def summary(chapters: Iterable[Chapter]) -> str:
    """A line a part, and one for each thing that makes the exit status 1."""
    lines = []
    for one in chapters:
        good = len(one.outcomes) - len(one.failed)
        failed = f"{len(one.failed)} failed, {len(one.missing)} have not run"
        lines.append(f"{one.part.name}: {good} of {len(one.steps)} steps succeeded, {failed}")
        lines += [f"  {line}" for line in one.problems]
        lines += [
            f"  {row.what} is {number(row.ours)} and has to be {number(row.reference)} {row.unit}"
            for row in one.unmet
        ]
    return "\n".join(lines)


def run(chosen: argparse.Namespace, parts: Mapping[str, Part]) -> int:
    """Run what was asked for and write the page; the exit status."""
    scale = Scale(quick=chosen.quick, full=chosen.full)
    store = ResultStore(STORES, scale)
    asked = [parts[name] for name in chosen.only]
    if not chosen.page_only:
        try:
            run_parts(asked, scale, store, restart=chosen.restart)
        except (StackGoneError, StoreBusyError) as error:
            sys.stderr.write(f"experiments: {error}\n")
            return FAILED
        except KeyboardInterrupt:
            sys.stderr.write(f"experiments: {GO_ON}\n")
            return INTERRUPTED
    chapters = [chapter(part, scale, store) for part in parts.values()]
    page = write_page(QUICK_PAGE if scale.quick else PAGE, chapters, scale, store)
    ours = [one for one in chapters if one.part in asked]
    sys.stdout.write(f"{summary(ours)}\ntracebacks, if any, are in {store.log}\n")
    sys.stdout.write(f"the page is {page}\n")
    return 0 if all(one.is_fine for one in ours) else FAILED


if __name__ == "__main__":
    sys.exit(run(arguments(), {part.name: part for part in PARTS}))

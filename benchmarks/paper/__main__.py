"""`make experiments`: runs the paper's experiments against a stack of its own and writes docs/experiments/.

A run that was interrupted goes on where it was when it is started again; a finished one starts anew, and what it had
measured is moved away. The exit status is 1 when a step has failed, something is missing, or a figure that has to be
met exactly is not; the page is written before.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager

from paper import high_rate, mixed, operators, peers, spiral, startup
from paper.circumstances import ROOT
from paper.page import Chapter, chapter
from paper.page_files import write_page
from paper.runner import Runner, StackGoneError
from paper.step import Comparison, Part, Scale
from paper.store import ResultStore, StoreBusyError
from paper.words import number
from paper.world import World

# All experiments, in the page's order.
PARTS = (startup.PART, high_rate.PART, mixed.PART, spiral.PART, operators.PART, peers.PART)
NAMES = tuple(part.name for part in PARTS)
ARTIFACTS = ROOT / "tests" / "artifacts"
STORES = ARTIFACTS / "experiments"
PAGE, QUICK_PAGE = ROOT / "docs" / "experiments", ARTIFACTS / "experiments-quick"
FAILED, INTERRUPTED = 1, 130
SWITCHES = {
    "--on-demo": "use the stack of make up or make demo, not one of its own",
    "--restart": "measure anew what an earlier run has measured",
    "--page-only": "run nothing; write the page from what was measured",
}
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
    scale = parser.add_mutually_exclusive_group()
    scale.add_argument(
        "--quick", action="store_true", help="all of it small; the page goes to tests/artifacts"
    )
    scale.add_argument("--full", action="store_true", help="the paper's 1000 repetitions")
    known = ", ".join(NAMES)
    parser.add_argument(
        "--only", type=names_of, default=list(NAMES), metavar="PART,...", help=f"run these: {known}"
    )
    for name, meaning in SWITCHES.items():
        parser.add_argument(name, action="store_true", help=meaning)
    return parser.parse_args(words)


def world_of(on_demo: bool) -> AbstractContextManager[World]:
    """The stack that is measured."""
    return World.on_demo() if on_demo else World.own()


def summary(chapters: Iterable[Chapter]) -> str:
    """A line a part, and one for each thing that makes the exit status 1."""
    lines = []
    for one in chapters:
        good = len(one.stored) - len(one.failed)
        failed = f"{len(one.failed)} failed, {len(one.missing)} have not run"
        lines.append(f"{one.part.name}: {good} of {len(one.steps)} steps succeeded, {failed}")
        lines += [f"  {line}" for line in [*one.problems, *map(unmet_line, one.unmet)]]
    return "\n".join(lines)


def unmet_line(row: Comparison) -> str:
    """What had to be equal, and is not."""
    return f"{row.what} is {number(row.ours)} and has to be {number(row.reference)} {row.unit}"


def run(chosen: argparse.Namespace, parts: Mapping[str, Part]) -> int:
    """Run what was asked for and write the page; the exit status."""
    scale = Scale(quick=chosen.quick, full=chosen.full)
    store = ResultStore(STORES, scale)
    runner = Runner(
        scale=scale,
        store=store,
        open_world=lambda: world_of(chosen.on_demo),
        notes={"stack": "the one that ran already" if chosen.on_demo else "one of its own"},
    )
    asked = [parts[name] for name in chosen.only]
    if not chosen.page_only:
        try:
            runner.run(asked, restart=chosen.restart)
        except (StackGoneError, StoreBusyError) as error:
            sys.stderr.write(f"experiments: {error}\n")
            return FAILED
        except KeyboardInterrupt:
            sys.stderr.write(f"experiments: {GO_ON}\n")
            return INTERRUPTED
    chapters = [chapter(part, scale, store) for part in parts.values()]
    folder = QUICK_PAGE if scale.quick else PAGE
    write_page(folder, chapters, scale, store)
    ours = [one for one in chapters if one.part in asked]
    sys.stdout.write(f"{summary(ours)}\ntracebacks, if any, are in {store.log}\n")
    sys.stdout.write(f"the page is {folder / 'index.html'}\n")
    return 0 if all(one.is_fine for one in ours) else FAILED


if __name__ == "__main__":
    sys.exit(run(arguments(), {part.name: part for part in PARTS}))

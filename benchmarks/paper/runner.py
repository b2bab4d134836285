"""Runs steps, each once, and keeps what became of it at once.

A step that raises has failed and stays failed. What ends the run instead is Ctrl-C, which leaves the step out, and a
stack that no longer answers, which would fail all that follows without a word.
"""

from __future__ import annotations

import asyncio
import os
import re
import sys
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from paper import circumstances
from paper.progress import Progress
from paper.step import Outcome, Part, Scale, Step
from paper.store import ResultStore, StoredOutcome, now, scale_name

if TYPE_CHECKING:
    from paper.world import World

# A path that nginx, web and the database take part in, and that costs the same however many robots there are.
CHEAP_PATH = "/me"
# A step may end while the services that it has restarted come back.
ANSWER_S, ASK_AGAIN_S = 60.0, 0.5
LONGEST_FAILURE = 300
_STEP_NAME = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")

# A part and those of its steps that have not run yet.
Waiting = Sequence[tuple[Part, Sequence[Step]]]


class StackGoneError(Exception):
    """The stack does not answer, so that nothing more can be measured."""


@dataclass
class Runner:
    """One process's work on the chosen parts."""

    scale: Scale
    store: ResultStore
    # Makes the stack, or finds the one that runs; called only when a step has to run.
    open_world: Callable[[], AbstractContextManager[World]]
    # Kept beside machine and commit: how the stack came to be, for instance.
    notes: Mapping[str, Any] = field(default_factory=dict)
    versions: Callable[[World], Mapping[str, str]] = circumstances.versions
    commit: str = field(default_factory=circumstances.commit)
    answer_s: float = ANSWER_S

    def run(self, parts: Sequence[Part], *, restart: bool = False) -> None:
        """Run all steps of these parts that have not run; all of them, if none is left or with `restart`.

        Raises StackGoneError, and JournalBusyError if another process measures one of these parts.
        """
        steps = {part.name: checked_steps(part, self.scale) for part in parts}
        with self.store.held(parts):
            if restart or not any(some for _, some in self._waiting(parts, steps)):
                for part in parts:
                    self.store.set_aside(part)
            self._run(self._waiting(parts, steps))

    def _waiting(self, parts: Sequence[Part], steps: Mapping[str, Sequence[Step]]) -> Waiting:
        waiting = []
        for part in parts:
            known = self.store.read(part, [step.name for step in steps[part.name]])
            waiting.append((part, [step for step in steps[part.name] if step.name not in known]))
        return waiting

    def _run(self, waiting: Waiting) -> None:
        expected_s = sum(step.expected_s for _, some in waiting for step in some)
        with Progress(expected_s) as progress:
            count = sum(len(some) for _, some in waiting)
            progress.say(f"{count} steps to run; what is kept of them is in {self.store.folder}")
            invocation = {
                "began": now(),
                "scale": scale_name(self.scale),
                "commit": self.commit,
                **circumstances.machine(),
                **self.notes,
            }
            self.store.write_invocation(invocation)
            with self.open_world() as world:
                invocation["versions"] = dict(self.versions(world))
                self.store.write_invocation(invocation)
                for part, some in waiting:
                    self._run_part(part, some, world, progress)
            self.store.write_invocation({**invocation, "ended": now()})

    def _run_part(
        self, part: Part, steps: Sequence[Step], world: World, progress: Progress
    ) -> None:
        for step in steps:
            self._check_answers(world, f"{part.name}, {step.name}")
            with progress.step(f"{part.name}: {step.title}", step.expected_s):
                outcome = self._run_step(part, step, world)
            if outcome.failure:
                progress.say(f"FAILED {part.name}, {step.name}: {outcome.failure}")

    def _run_step(self, part: Part, step: Step, world: World) -> Outcome:
        """Run it and keep its outcome; only KeyboardInterrupt and the like get out, and leave nothing behind."""
        began, load, start = now(), os.getloadavg()[0], time.monotonic()
        outcome = Outcome(load=load)
        failure: BaseException | None = None
        try:
            values = step.run(world)
            outcome = Outcome(values=values, took_s=time.monotonic() - start, load=load)
            self.store.write(part, step.name, self._stored(outcome, began))
        # A task that was cancelled by nobody's Ctrl-C is this step's failure, too.
        except (Exception, asyncio.CancelledError) as error:  # noqa: BLE001 (the border of a step)
            failure = error
            self._log(f"{part.name}, {step.name}")
        if failure is not None:
            outcome = Outcome(failure=sentence(failure), took_s=time.monotonic() - start, load=load)
            self.store.write(part, step.name, self._stored(outcome, began))
        return outcome

    def _stored(self, outcome: Outcome, began: str) -> StoredOutcome:
        return StoredOutcome(
            outcome=outcome, commit=self.commit, began=began, invocation=self.store.invocation
        )

    def _check_answers(self, world: World, before: str) -> None:
        end = time.monotonic() + self.answer_s
        while (problem := _problem_of(world)) and time.monotonic() < end:
            time.sleep(ASK_AGAIN_S)
        if problem:
            raise StackGoneError(
                f"cannot go on before {before}: the stack has not answered for {self.answer_s:.0f} s ({problem}). "
                "What was measured is kept; start again to go on"
            )

    def _log(self, where: str) -> None:
        text = f"{now()} {where}\n{traceback.format_exc()}\n"
        with self.store.log.open("a") as log:
            log.write(text)
        if self.scale.quick:
            # Continuous integration keeps what is printed, and no files.
            sys.stderr.write(text)


def _problem_of(world: World) -> str:
    """Why the stack does not answer; empty when it does."""
    try:
        world.api("GET", CHEAP_PATH)
    except Exception as error:  # noqa: BLE001 (whatever it is, the stack did not answer)
        return sentence(error)
    return ""


def checked_steps(part: Part, scale: Scale) -> Sequence[Step]:
    """The part's steps; raises ValueError for names that the journal cannot have."""
    steps = part.steps(scale)
    names = [step.name for step in steps]
    for name in names:
        if not _STEP_NAME.fullmatch(name) or names.count(name) > 1:
            raise ValueError(
                f"cannot run {part.name}: its step {name!r} has a name with other signs than a-z, 0-9 "
                "and dashes between, or one that another step has, too"
            )
    return steps


def sentence(error: BaseException) -> str:
    """An exception in one line: its kind and what it says; of a group, those that it holds."""
    if isinstance(error, BaseExceptionGroup):  # noqa: F821 (ruff checks for 3.10; this runs from 3.11 on)
        return "; ".join(sentence(one) for one in error.exceptions)
    said = " ".join(str(error).split())
    if len(said) > LONGEST_FAILURE:
        said = f"{said[:LONGEST_FAILURE]}..."
    return f"{type(error).__name__}: {said}" if said else type(error).__name__

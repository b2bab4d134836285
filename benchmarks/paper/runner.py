"""Runs steps, each once, and keeps what became of it at once; a run that was interrupted goes on where it was.

A step that raises has failed and stays failed. What ends the run instead is Ctrl-C, which leaves the step out, and a
stack that no longer answers, which would fail all that follows without a word.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any

from paper import circumstances
from paper.step import Outcome, Part, Scale, Step
from paper.store import ResultStore, now
from paper.words import duration
from paper.world import World

# A path that nginx, web and the database take part in, and that costs the same however many robots there are.
CHEAP_PATH = "/me"
# A step may end while the services that it has restarted come back.
ANSWER_S, ASK_AGAIN_S = 60.0, 0.5
LONGEST_FAILURE = 300


class StackGoneError(Exception):
    """The stack does not answer, so that nothing more can be measured."""


def run_parts(
    parts: Sequence[Part],
    scale: Scale,
    store: ResultStore,
    *,
    restart: bool = False,
    open_world: Callable[[], AbstractContextManager[World]] = World.own,
    versions: Callable[[World], Mapping[str, str]] = circumstances.versions,
) -> None:
    """Run all steps of these parts that have not run; all of them, if none is left or with `restart`.

    Raises StackGoneError, and StoreBusyError if another process measures.
    """
    with store.held():
        if restart or not _waiting(parts, scale, store):
            store.set_aside(parts)
        waiting = _waiting(parts, scale, store)
        left_s = sum(step.expected_s for _, step in waiting)
        _say(f"{len(waiting)} steps to run, some {duration(left_s)}; results go to {store.path}")
        with open_world() as world:
            sitting = {"began": now(), "commit": circumstances.commit(), **circumstances.machine()}
            store.add_sitting({**sitting, "versions": dict(versions(world))})
            for part, step in waiting:
                _check_answers(world, f"{part.name}, {step.name}")
                expected = (
                    f"some {duration(step.expected_s)}; all that is left, some {duration(left_s)}"
                )
                _say(f"{part.name}: {step.title} ({expected})")
                outcome = _run_step(step, world, sitting, store)
                store.add(part, step.name, outcome)
                if outcome.failure:
                    _say(f"FAILED {part.name}, {step.name}: {outcome.failure}")
                left_s -= step.expected_s


def _waiting(parts: Sequence[Part], scale: Scale, store: ResultStore) -> list[tuple[Part, Step]]:
    """The steps that have not run yet."""
    known = {part.name: store.outcomes(part, scale) for part in parts}
    return [
        (part, step)
        for part in parts
        for step in part.steps(scale)
        if step.name not in known[part.name]
    ]


def _run_step(step: Step, world: World, sitting: Mapping[str, Any], store: ResultStore) -> Outcome:
    """Run it; only KeyboardInterrupt and the like get out, and leave nothing behind."""
    began, load, start = now(), os.getloadavg()[0], time.monotonic()
    values, failure = None, ""
    try:
        # What JSON cannot carry is this step's failure, too.
        values = json.loads(json.dumps(step.run(world), allow_nan=False))
    # And a task that was cancelled by nobody's Ctrl-C.
    except (Exception, asyncio.CancelledError) as error:  # noqa: BLE001 (the border of a step)
        failure = sentence(error)
        _log(store, step.title)
    return Outcome(
        values=values,
        failure=failure,
        took_s=time.monotonic() - start,
        load=load,
        began=began,
        commit=sitting["commit"],
        sitting=sitting["began"],
    )


def _check_answers(world: World, before: str) -> None:
    end = time.monotonic() + ANSWER_S
    while (problem := _problem_of(world)) and time.monotonic() < end:
        time.sleep(ASK_AGAIN_S)
    if problem:
        raise StackGoneError(
            f"cannot go on before {before}: the stack has not answered for {ANSWER_S:.0f} s ({problem}). "
            "What was measured is kept; start again to go on"
        )


def _problem_of(world: World) -> str:
    """Why the stack does not answer; empty when it does."""
    try:
        world.api("GET", CHEAP_PATH)
    except Exception as error:  # noqa: BLE001 (whatever it is, the stack did not answer)
        return sentence(error)
    return ""


def _log(store: ResultStore, where: str) -> None:
    """Keep the traceback; continuous integration keeps what is printed, and no files."""
    text = f"{now()} {where}\n{traceback.format_exc()}\n"
    with store.log.open("a") as log:
        log.write(text)
    sys.stderr.write(text)


def _say(line: str) -> None:
    sys.stderr.write(f"{line}\n")


def sentence(error: BaseException) -> str:
    """An exception in one line: its kind and what it says; of a group, those that it holds."""
    if isinstance(error, BaseExceptionGroup):  # noqa: F821 (ruff checks for 3.10; this runs from 3.11 on)
        return "; ".join(sentence(one) for one in error.exceptions)
    said = " ".join(str(error).split())
    if len(said) > LONGEST_FAILURE:
        said = f"{said[:LONGEST_FAILURE]}..."
    return f"{type(error).__name__}: {said}" if said else type(error).__name__

"""A machine's limits, and cells that break: each step is a test.

A step that raises has failed and stays failed. What ends the run instead is Ctrl-C, which leaves the step out, and a
stack that no longer answers, which would fail all that follows without a word.
"""

from __future__ import annotations

import asyncio
import json
import os
import time
from collections.abc import Mapping
from typing import Any

import pytest

from paper.cells import cells
from paper.conftest import scale_of
from paper.density import density
from paper.page import sentence
from paper.requests import requests
from paper.step import Outcome, Part, ResultStore, Step, now
from paper.world import World

# All experiments, in the page's order.
PARTS = (density.PART, cells.PART, requests.PART)
# A path that nginx, web and the database take part in, and that costs the same however many robots there are.
CHEAP_PATH = "/me"
# A step may end while the services that it has restarted come back.
ANSWER_S, ASK_AGAIN_S = 60.0, 0.5


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    scale = scale_of(metafunc.config)
    steps = [(part, step) for part in PARTS for step in part.steps(scale)]
    names = [f"{part.name}-{step.name}" for part, step in steps]
    metafunc.parametrize(("part", "step"), steps, ids=names)


def test_step(
    part: Part, step: Step, world: World, store: ResultStore, circumstances: Mapping[str, str]
) -> None:
    if problem := problem_of(world):
        pytest.exit(f"cannot go on before {step.title}: {problem}. What was measured is kept")
    began, load, start = now(), os.getloadavg()[0], time.monotonic()

    def keep(values: Any = None, failure: str = "") -> None:
        outcome = Outcome(
            values=values,
            failure=failure,
            took_s=time.monotonic() - start,
            load=load,
            began=began,
            **circumstances,
        )
        store.add((part.name, step.name), outcome)

    try:
        # What JSON cannot carry is this step's failure, too.
        keep(json.loads(json.dumps(step.run(world), allow_nan=False)))
    # And a task that was cancelled by nobody's Ctrl-C.
    except (Exception, asyncio.CancelledError) as error:
        keep(failure=sentence(error))
        raise


def problem_of(world: World) -> str:
    """Why the stack does not answer; empty when it does, if need be after a while."""
    end = time.monotonic() + ANSWER_S
    while True:
        try:
            world.ask("GET", CHEAP_PATH)
        except Exception as error:  # noqa: BLE001 (whatever it is, the stack did not answer)
            if time.monotonic() > end:
                return f"the stack has not answered for {ANSWER_S:.0f} s ({sentence(error)})"
        else:
            return ""
        time.sleep(ASK_AGAIN_S)

"""The nemesis: the same faults by the same seed, one cell whole beside them, and all mended at the end."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any, cast

import pytest
from paper.cells import nemesis as module
from paper.cells.history import History
from paper.cells.nemesis import DRAINED, FAULTS, TAKES_A_CELL, Context, Fault, Nemesis, Target

Actions = list[tuple[str, str]]


def context(seed: int = 1, cells: str = "abc") -> Context:
    site = cast(Any, SimpleNamespace(names=list(cells), cells=[]))
    return Context(site, cast(Any, {"robots-1": None, "robots-2": None}), Random(seed))


def noting(actions: Actions, *, failing: str = "") -> dict[str, Fault]:
    """Faults that only note what is done."""

    def fault(name: str) -> Fault:
        def mend(_: Context, __: Target) -> None:
            actions.append(("mend", name))
            if name == failing:
                raise RuntimeError("it is on fire")

        return replace(FAULTS[name], do=lambda _, __: actions.append(("do", name)), mend=mend)

    return {name: fault(name) for name in FAULTS}


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LASTS_S", (0.02, 0.05))
    monkeypatch.setattr(module, "BETWEEN_S", (0.01, 0.03))


@pytest.fixture
def history(tmp_path: Path) -> Iterator[History]:
    item = History.open(tmp_path, "nemesis")
    yield item
    item.close()


def open_nemesis(history: History, actions: Actions, **how: Any) -> Nemesis:
    return Nemesis(context(), history, noting(actions, **how))


async def test_one_cell_stays_whole(history: History, quick: None) -> None:
    actions: Actions = []
    await open_nemesis(history, actions).run(1.0)
    takers = [what for what, name in actions if name in TAKES_A_CELL - {DRAINED}]
    # One of them is mended before the next is done; a drain may be beside it.
    assert takers[::2] == ["do"] * len(takers[::2])
    assert takers[1::2] == ["mend"] * len(takers[1::2])


async def takers_beside(
    history: History, name: str, target: Target, cells: str = "abc"
) -> dict[str, set[str]]:
    """What takes a cell and may be chosen beside a fault, with its cells."""
    item = Nemesis(context(cells=cells), history, noting([]))
    await item.begin(name, target)
    found: dict[str, set[str]] = {}
    for _ in range(500):
        chosen = item.choose()
        if chosen is not None and chosen[0] in TAKES_A_CELL:
            found.setdefault(chosen[0], set()).add(chosen[1].cell)
    return found


async def test_another_cell_breaks_while_one_is_drained(history: History) -> None:
    beside = await takers_beside(history, DRAINED, Target("b"))
    assert beside == {item: {"a", "c"} for item in TAKES_A_CELL - {DRAINED, "database_away"}}


@pytest.mark.parametrize("name", sorted(TAKES_A_CELL - {DRAINED, "database_away"}))
async def test_another_cell_is_drained_while_one_is_broken(history: History, name: str) -> None:
    assert await takers_beside(history, name, Target("b")) == {DRAINED: {"a", "c"}}


async def test_nothing_is_drained_without_a_database_or_a_third_cell(history: History) -> None:
    assert await takers_beside(history, "database_away", Target()) == {}
    for name in (DRAINED, "cell_killed"):
        assert await takers_beside(history, name, Target("b"), cells="ab") == {}

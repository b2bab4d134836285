"""The nemesis leaves one cell whole."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any, cast

import pytest
from paper.cells.history import History
from paper.cells.nemesis import DRAINED, FAULTS, TAKES_A_CELL, Context, Nemesis, Target

# What takes a cell and has one, so that another can be drained beside it.
OF_A_CELL = TAKES_A_CELL - {DRAINED, "database_away"}


async def takers_beside(
    folder: Path, name: str, target: Target, cells: str = "abc"
) -> dict[str, set[str]]:
    """What takes a cell and may be chosen beside a fault, with its cells."""
    site = cast(Any, SimpleNamespace(names=list(cells), cells=[]))
    context = Context(site, cast(Any, {"robots-1": None, "robots-2": None}), Random(1))
    faults = {
        fault: replace(made, do=lambda *_: None, mend=lambda *_: None)
        for fault, made in FAULTS.items()
    }
    item = Nemesis(context, History.open(folder, "nemesis"), faults)
    await item.begin(name, target)
    found: dict[str, set[str]] = {}
    for _ in range(500):
        chosen = item.choose()
        if chosen is not None and chosen[0] in TAKES_A_CELL:
            found.setdefault(chosen[0], set()).add(chosen[1].cell)
    item.history.close()
    return found


@pytest.mark.parametrize(
    ("name", "target", "cells", "beside"),
    [
        (DRAINED, Target("b"), "abc", {name: {"a", "c"} for name in OF_A_CELL}),
        *((name, Target("b"), "abc", {DRAINED: {"a", "c"}}) for name in sorted(OF_A_CELL)),
        ("database_away", Target(), "abc", {}),
        (DRAINED, Target("b"), "ab", {}),
        ("cell_killed", Target("b"), "ab", {}),
    ],
)
async def test_one_cell_stays_whole(
    tmp_path: Path, name: str, target: Target, cells: str, beside: dict[str, set[str]]
) -> None:
    assert await takers_beside(tmp_path, name, target, cells) == beside

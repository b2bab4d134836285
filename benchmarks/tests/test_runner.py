"""Steps run once each; what became of them is kept, whatever ends the run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from paper import __main__ as program
from paper.runner import run_parts
from paper.step import Comparison, Part, Report, Scale, Step
from paper.store import ResultStore

QUICK = Scale(quick=True)


class FakeWorld:
    """Stands in for a stack that answers."""

    def api(self, _method: str, _path: str) -> dict[str, str]:
        return {"name": "admin"}


@contextmanager
def world() -> Iterator[FakeWorld]:
    yield FakeWorld()


# Without the stack of its own.
run: Callable[..., None] = partial(
    run_parts, open_world=world, versions=lambda _world: {"nginx": "1.2"}
)


class Rig:
    """Results in a folder, and steps that say that they ran."""

    def __init__(self, folder: Path) -> None:
        self.store = ResultStore(folder, QUICK)
        self.ran: list[str] = []

    def run(self, part: Part) -> None:
        run([part], QUICK, self.store)

    def step(self, name: str, run: Callable[[Any], Any] | None = None) -> Step:
        def noted(world: Any) -> Any:
            self.ran.append(name)
            return {"value": 1} if run is None else run(world)

        return Step(name=name, title=f"step {name}", expected_s=1, run=noted)


def part(*steps: Step) -> Part:
    return Part(
        name="test",
        title="A test",
        steps=lambda _scale: steps,
        report=lambda _scale, _results: Report(sections=()),
    )


def raises(error: BaseException) -> Callable[[Any], Any]:
    def run(_world: Any) -> Any:
        raise error

    return run


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return Rig(tmp_path)


def test_failed_step_is_kept_and_the_next_one_runs(rig: Rig) -> None:
    """One failure is one failure: its reason is kept, and the others are measured."""
    one = part(
        rig.step("bad", raises(RuntimeError("no tunnel"))),
        rig.step("no-json", lambda _world: {"value": float("nan")}),
        rig.step("good"),
    )
    rig.run(one)
    kept = rig.store.outcomes(one, QUICK)
    assert kept["bad"].values is None
    assert kept["bad"].failure == "RuntimeError: no tunnel"
    assert kept["no-json"].failure.startswith("ValueError")
    assert kept["good"].values == {"value": 1}
    assert "no tunnel" in rig.store.log.read_text()


def test_interrupted_run_goes_on_and_runs_nothing_twice(rig: Rig) -> None:
    """Ctrl-C leaves its step out; the next run starts with it, and failed steps stay as they are."""
    interrupt: list[BaseException] = [KeyboardInterrupt()]

    def once(_world: Any) -> dict[str, int]:
        if interrupt:
            raise interrupt.pop()
        return {"value": 2}

    one = part(rig.step("bad", raises(ValueError("bad"))), rig.step("cut", once), rig.step("last"))
    with pytest.raises(KeyboardInterrupt):
        rig.run(one)
    assert list(rig.store.outcomes(one, QUICK)) == ["bad"]
    rig.run(one)
    assert rig.ran == ["bad", "cut", "cut", "last"]
    assert list(rig.store.outcomes(one, QUICK)) == ["bad", "cut", "last"]


def test_finished_run_starts_anew_and_loses_nothing(rig: Rig) -> None:
    """What was measured goes to a file of its own, and other parts stay."""
    one, other = part(rig.step("one")), replace(part(rig.step("two")), name="other")
    run([one, other], QUICK, rig.store)
    before = rig.store.path.read_text()
    rig.run(one)
    assert rig.ran == ["one", "two", "one"]
    assert list(rig.store.outcomes(other, QUICK)) == ["two"]
    [aside] = rig.store.path.parent.glob("quick-*.jsonl")
    assert aside.read_text() == before


def test_failed_step_or_unmet_figure_fails_the_command(
    rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Continuous integration reads the exit status alone; the page is written all the same."""
    monkeypatch.setattr(program, "STORES", tmp_path / "results")
    monkeypatch.setattr(program, "QUICK_PAGE", tmp_path / "page")
    monkeypatch.setattr(program, "run_parts", run)
    lost = Comparison(
        what="success", against="paper", reference=100, ours=99.9, unit="%", better="equal"
    )
    unmet = replace(
        part(rig.step("one")),
        report=lambda _scale, _results: Report(sections=(), comparisons=[lost]),
    )
    parts = (part(rig.step("one")), part(rig.step("bad", raises(OSError("gone")))), unmet)
    chosen = program.arguments(["--quick"])
    chosen.only = ["test"]
    assert [program.run(chosen, {"test": one}) for one in parts] == [0, 1, 1]
    page = (tmp_path / "page" / "index.md").read_text()
    assert "| A test | success | paper | 100 % | 99.9 % | 0.999 | equal | **falls short** |" in page

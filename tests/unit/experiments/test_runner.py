"""Steps run once each; what became of them is kept, whatever ends the run."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from paper.journal import Journal, JournalBusyError
from paper.runner import Runner, StackGoneError, checked_steps, sentence
from paper.step import Part, Report, Scale, Step

QUICK = Scale(quick=True)


class FakeWorld:
    """Stands in for a stack: answers, until it is told not to."""

    answers = True

    def api(self, _method: str, _path: str) -> dict[str, str]:
        if not self.answers:
            raise ConnectionRefusedError("nobody there")
        return {"name": "admin"}


class Bench:
    """A journal in a folder, worlds that are counted, and steps that say that they ran."""

    def __init__(self, folder: Path) -> None:
        self.journal = Journal(folder, QUICK)
        self.worlds: list[FakeWorld] = []
        self.ran: list[str] = []

    @contextmanager
    def world(self) -> Iterator[FakeWorld]:
        self.worlds.append(FakeWorld())
        yield self.worlds[-1]

    def runner(self, commit: str = "abc") -> Runner:
        return Runner(
            scale=QUICK,
            journal=self.journal,
            open_world=self.world,  # type: ignore[arg-type]
            versions=lambda _world: {"nginx": "1.2"},
            commit=commit,
            answer_s=0.1,
        )

    def step(self, name: str, run: Callable[[Any], Any] | None = None) -> Step:
        def noted(world: Any) -> Any:
            self.ran.append(name)
            return {"value": 1} if run is None else run(world)

        return Step(name=name, title=f"step {name}", expected_s=1, run=noted)

    def kept(self, of: Part) -> dict[str, Any]:
        names = [step.name for step in of.steps(QUICK)]
        return {name: one.outcome for name, one in self.journal.read(of, names).items()}


def part(*steps: Step, name: str = "test") -> Part:
    return Part(
        name=name,
        title="A test",
        steps=lambda _scale: steps,
        report=lambda _scale, _results: Report(sections=()),
    )


def raises(error: BaseException) -> Callable[[Any], Any]:
    def run(_world: Any) -> Any:
        raise error

    return run


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def test_outcomes_are_kept_with_commit_and_load(bench: Bench) -> None:
    """A step's values stand in the journal with what tells how they came to be."""
    one = part(bench.step("first"))
    bench.runner().run([one])
    kept = bench.journal.read(one, ["first"])["first"]
    assert kept.outcome.values == {"value": 1}
    assert kept.commit == "abc"
    assert kept.outcome.load >= 0
    [sitting] = bench.journal.sittings([kept])
    assert sitting["versions"] == {"nginx": "1.2"}
    assert sitting["cores"] > 0


def test_failed_step_is_kept_and_the_next_one_runs(bench: Bench) -> None:
    """One failure is one failure: its reason is kept, and the others are measured."""
    one = part(bench.step("bad", raises(RuntimeError("no tunnel"))), bench.step("good"))
    bench.runner().run([one])
    kept = bench.kept(one)
    assert kept["bad"].values is None
    assert kept["bad"].failure == "RuntimeError: no tunnel"
    assert kept["good"].values == {"value": 1}
    assert "no tunnel" in bench.journal.log.read_text()


def test_interrupted_run_goes_on_and_runs_nothing_twice(bench: Bench) -> None:
    """Ctrl-C leaves its step out; the next run starts with it, and failed steps stay as they are."""
    interrupt: list[BaseException] = [KeyboardInterrupt()]

    def once(_world: Any) -> dict[str, int]:
        if interrupt:
            raise interrupt.pop()
        return {"value": 2}

    one = part(
        bench.step("bad", raises(ValueError("bad"))), bench.step("cut", once), bench.step("last")
    )
    with pytest.raises(KeyboardInterrupt):
        bench.runner("abc").run([one])
    assert list(bench.kept(one)) == ["bad"]
    bench.runner("def").run([one])
    assert bench.ran == ["bad", "cut", "cut", "last"]
    kept = bench.journal.read(one, ["bad", "cut", "last"])
    assert [step.commit for step in kept.values()] == ["abc", "def", "def"]


def test_finished_run_starts_anew_and_the_old_is_kept(bench: Bench) -> None:
    """What was measured before is moved away and not deleted."""
    one = part(bench.step("only"))
    bench.runner().run([one])
    bench.runner().run([one])
    assert bench.ran == ["only", "only"]
    assert len(list((bench.journal.folder / "old").glob("*/test/only.json"))) == 1


def test_restart_measures_the_named_parts_alone_anew(bench: Bench) -> None:
    """An unfinished run's other parts keep what they have."""
    first = part(bench.step("a"), name="first")
    second = part(bench.step("b"), name="second")
    bench.runner().run([first])
    bench.runner().run([second], restart=True)
    bench.runner().run([second], restart=True)
    assert bench.ran == ["a", "b", "b"]
    assert list(bench.kept(first)) == ["a"]


def test_stack_that_does_not_answer_ends_the_run(bench: Bench) -> None:
    """The steps that follow are not failed one after the other: they have not run."""

    def break_it(world: FakeWorld) -> dict[str, int]:
        world.answers = False
        return {"value": 1}

    one = part(bench.step("breaks", break_it), bench.step("next"))
    with pytest.raises(StackGoneError, match=r"before test, next.*nobody there"):
        bench.runner().run([one])
    assert list(bench.kept(one)) == ["breaks"]


def test_values_that_json_cannot_carry_fail_their_step(bench: Bench) -> None:
    """What could not be read again from the journal is no result."""
    one = part(bench.step("odd", lambda _: {"value": float("nan")}))
    bench.runner().run([one])
    assert bench.kept(one)["odd"].failure.startswith("ValueError: ")


def test_cancelled_task_of_a_step_is_its_failure(bench: Bench) -> None:
    """A step's own cancellation does not end the run."""
    one = part(bench.step("cancelled", raises(asyncio.CancelledError())), bench.step("next"))
    bench.runner().run([one])
    assert bench.kept(one)["cancelled"].failure == "CancelledError"
    assert bench.ran == ["cancelled", "next"]


def test_two_runs_of_one_part_at_once_are_refused(bench: Bench) -> None:
    """The second one would take steps of the first for its own."""
    one = part(bench.step("only"))
    with bench.journal.held([one]), pytest.raises(JournalBusyError, match="test"):
        bench.runner().run([one])
    assert bench.worlds == []


@pytest.mark.parametrize("names", [("a", "a"), ("../a",), ("A",), ("",)])
def test_steps_names_are_good_for_files(bench: Bench, names: tuple[str, ...]) -> None:
    """A name that is there twice, or is no file's, is refused before anything runs."""
    with pytest.raises(ValueError, match="cannot run test"):
        checked_steps(part(*map(bench.step, names)), QUICK)


def test_sentence_of_an_exception_is_one_short_line() -> None:
    """Also of a group, and of a message that holds a whole log."""
    assert sentence(ValueError("two\nlines")) == "ValueError: two lines"
    assert sentence(TimeoutError()) == "TimeoutError"
    both = ExceptionGroup("in a task group", [ValueError("a"), OSError("b")])  # noqa: F821 (3.11)
    assert sentence(both) == "ValueError: a; OSError: b"
    assert len(sentence(ValueError("x" * 10_000))) < 400

"""`python -m paper`: what it runs, what it writes, and what its exit status says."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from paper import __main__ as program
from paper.runner import Runner
from paper.step import Comparison, Part, Report, Results, Scale, Step


class FakeWorld:
    """Stands in for a stack that answers."""

    def api(self, _method: str, _path: str) -> None:
        return None


@contextmanager
def fake_world(_on_demo: bool) -> Iterator[FakeWorld]:
    yield FakeWorld()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Everything is written here, and worlds and versions are doubles."""
    monkeypatch.setattr(program, "JOURNALS", tmp_path / "journals")
    monkeypatch.setattr(program, "PAGE", tmp_path / "docs")
    monkeypatch.setattr(program, "QUICK_PAGE", tmp_path / "quick")
    monkeypatch.setattr(program, "world_of", fake_world)
    asked = partial(Runner, versions=lambda _world: {"nginx": "1.2"}, answer_s=0.1)
    monkeypatch.setattr(program, "Runner", asked)
    return tmp_path


def part(name: str, run: Callable[[Any], Any], ours: float = 100) -> Part:
    def report(_scale: Scale, _results: Results) -> Report:
        success = Comparison(
            what="success", against="paper", reference=100, ours=ours, unit="%", better="equal"
        )
        return Report(sections=(), comparisons=[success])

    return Part(
        name=name,
        title=f"Part {name}",
        steps=lambda _scale: [Step(name="only", title="the only one", expected_s=1, run=run)],
        report=report,
    )


def good(_world: Any) -> dict[str, int]:
    return {"value": 1}


def bad(_world: Any) -> dict[str, int]:
    raise OSError("no tunnel")


def cut(_world: Any) -> dict[str, int]:
    raise KeyboardInterrupt


def start(parts: list[Part], *words: str) -> int:
    return program.run(program.arguments(words), {one.name: one for one in parts})


def test_names_are_those_of_the_parts() -> None:
    """What --only takes is what the parts call themselves."""
    assert [part.name for part in program.PARTS] == [
        "startup",
        "high_rate",
        "mixed",
        "spiral",
        "operators",
        "peers",
    ]


def test_all_succeeded_is_0(folder: Path) -> None:
    """And the page stands in the documentation."""
    assert start([part("startup", good)], "--only", "startup") == 0
    assert {path.name for path in (folder / "docs").iterdir()} == {"index.md", "index.html"}


@pytest.mark.parametrize("parts", [[part("startup", bad)], [part("startup", good, ours=99)]])
def test_failed_step_or_unmet_figure_is_1_after_the_page_is_written(
    folder: Path, parts: list[Part], capsys: pytest.CaptureFixture[str]
) -> None:
    """Continuous integration notices, and says what it was."""
    assert start(parts, "--only", "startup") == 1
    assert (folder / "docs" / "index.md").exists()
    out = capsys.readouterr().out
    assert "1 failed" in out or "success is 99 and has to be 100 %" in out


def test_other_parts_that_are_missing_fail_nothing(folder: Path) -> None:
    """With --only, the exit status is of these parts; the page names the others."""
    parts = [part("startup", good), part("spiral", bad)]
    assert start(parts, "--only", "startup") == 0
    assert "Part spiral: 1 of 1 steps have not run." in (folder / "docs" / "index.md").read_text()


def test_quick_run_leaves_the_documentation_alone(folder: Path) -> None:
    """Its figures are no measurements, and its page says so."""
    assert start([part("startup", good)], "--only", "startup", "--quick") == 0
    assert not (folder / "docs").exists()
    assert "**A quick run**" in (folder / "quick" / "index.md").read_text()


def test_interrupted_run_writes_no_page_and_says_how_to_go_on(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A page of half a run does not take the place of a whole one's unasked."""
    assert start([part("startup", cut)], "--only", "startup") == program.INTERRUPTED
    assert not (folder / "docs").exists()
    assert "the same command goes on where it was" in capsys.readouterr().err


def test_page_only_runs_nothing(folder: Path) -> None:
    """It writes what was kept once more."""
    start([part("startup", good)], "--only", "startup")
    (folder / "docs" / "index.md").unlink()
    assert start([part("startup", cut)], "--only", "startup", "--page-only") == 0
    assert "1 of 1 steps succeeded" in (folder / "docs" / "index.md").read_text()


def test_unknown_part_is_refused_with_those_that_are_known(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Before anything runs."""
    with pytest.raises(SystemExit):
        program.arguments(["--only", "spirals"])
    assert "there is no experiment spirals; there are startup," in capsys.readouterr().err


def test_parts_run_in_the_pages_order() -> None:
    """However they are named."""
    assert program.arguments(["--only", "peers,startup"]).only == ["startup", "peers"]

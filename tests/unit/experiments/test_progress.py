"""How far a run is, for people and for logs."""

from __future__ import annotations

import io
import threading

import pytest
from paper.progress import Progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_log_has_a_line_a_step_with_what_is_left() -> None:
    """A file gets no bar."""
    stream = io.StringIO()
    with Progress(20, stream) as progress:
        with progress.step("first", 15):
            pass
        with progress.step("second", 5):
            pass
        progress.say("FAILED second")
    assert stream.getvalue().splitlines() == [
        "first (some 15.0 s; all that is left, some 20.0 s)",
        "second (some 5.0 s; all that is left, some 5.0 s)",
        "FAILED second",
    ]


def test_terminal_has_a_bar_that_ends_full() -> None:
    """It counts expected seconds, however long a step took, and leaves no thread."""
    stream = Terminal()
    with Progress(20, stream) as progress:
        with progress.step("first", 15):
            pass
        progress.say("a line above")
        with progress.step("second", 5):
            pass
    assert "second 100% " in stream.getvalue()
    assert "a line above\n" in stream.getvalue()
    assert "progress" not in [thread.name for thread in threading.enumerate()]


def test_interrupted_step_does_not_count(capsys: pytest.CaptureFixture[str]) -> None:
    """What gets out of a step passes through, and no thread stays."""
    stream = Terminal()
    with (
        pytest.raises(KeyboardInterrupt),
        Progress(20, stream) as progress,
        progress.step("first", 15),
    ):
        raise KeyboardInterrupt
    assert "100%" not in stream.getvalue()
    assert "progress" not in [thread.name for thread in threading.enumerate()]
    assert capsys.readouterr().err == ""

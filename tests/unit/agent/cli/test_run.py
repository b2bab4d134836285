"""The boot service's own command, for what shows only in its exit code and its log."""

from __future__ import annotations

import logging

from robotether_agent.cli import run as command
from robotether_agent.problems import AlreadyRunning
from robotether_agent.settings import Settings


def test_an_error_of_the_agent_itself_leaves_its_traceback(monkeypatch, place, capsys):
    """Systemd starts it again, and the journal has what a developer needs."""

    class Broken:
        def __init__(self, *_: object) -> None:
            raise ZeroDivisionError("a defect")

    monkeypatch.setattr(command, "Agent", Broken)
    assert command.run(Settings(server="a.example", run_dir=place), {}) == 1
    told = capsys.readouterr().err
    assert "stopped by an error in the agent itself" in told
    assert "ZeroDivisionError: a defect" in told


def test_a_problem_that_ends_it_has_its_exit_code(monkeypatch, place, capsys):
    """A person reads one sentence, and no traceback."""

    class Second:
        def __init__(self, *_: object) -> None:
            raise AlreadyRunning("cannot start: another agent runs")

    monkeypatch.setattr(command, "Agent", Second)
    code = command.run(Settings(server="a.example", run_dir=place), {"JOURNAL_STREAM": "1:2"})
    assert code == AlreadyRunning.exit_code
    assert capsys.readouterr().err.splitlines() == [
        "<2>STOPPED: cannot start: another agent runs [already_running]"
    ]


def teardown_module() -> None:
    """The handler writes to what pytest captured."""
    logging.getLogger().handlers.clear()

"""What a person sees of an examination, and its exit code."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from robotether_agent.cli import doctor as command
from robotether_agent.cli.main import main
from robotether_agent.doctor.findings import Finding, fail, ok, skipped
from robotether_agent.settings import Settings


@pytest.mark.parametrize(
    ("findings", "code", "last"),
    [
        ([ok("a", "x"), skipped("b", "y")], 0, "all is well"),
        ([ok("a", "x"), fail("b", "y", "z"), fail("c", "y", "z")], 1, "2 of these steps failed"),
    ],
)
def test_the_exit_code_is_the_worst_of_all(monkeypatch, capsys, findings, code, last):
    settings = Settings(server="a.example", state_dir=Path("/none"))

    async def run_checks(_: Settings) -> AsyncIterator[Finding]:
        for finding in findings:
            yield finding

    monkeypatch.setattr(command, "run_checks", run_checks)
    assert command.doctor(lambda: settings) == code
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "ok       a            x"
    assert lines[-1] == last


def test_wrong_settings_are_the_first_finding(capsys):
    """Nothing else can be looked at without them."""
    assert main(["doctor"], {"ROBOTETHER_SERVER": "https://a"}) == 1
    told = capsys.readouterr().out
    assert told.startswith("FAIL     settings     cannot use ROBOTETHER_SERVER")
    assert "what to do: correct it" in told

"""The status for programs; for people it is tested with a running agent."""

from __future__ import annotations

import json

from robotether_agent.cli.status import status
from robotether_agent.settings import Settings
from robotether_agent.status import StatusWriter


def test_for_programs_it_is_one_object(place, capsys):
    """What the file holds, and whether whoever wrote it runs; the exit code is the same as for people."""
    settings = Settings(server="a.example", run_dir=place)
    assert status(settings, as_json=True) == 1
    assert json.loads(capsys.readouterr().out) == {"is_running": False}
    board = StatusWriter(place, "a.example", on_state=lambda _: None)
    board.set(state="connected", robot="sim1")
    assert status(settings, as_json=True) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["is_running"], told["state"], told["robot"]) == (True, "connected", "sim1")
    board.set(state="stopped")
    assert status(settings, as_json=True) == 1
    assert json.loads(capsys.readouterr().out)["is_running"] is False

"""The command itself: settings, migrate, web, and the border of errors."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mariadb_server import MariaDb

Run = Callable[..., Any]


def test_settings_are_shown_without_secrets(run: Run, mariadb: MariaDb) -> None:
    """One NAME=value a line."""
    done = run("show-settings")
    lines = dict(line.split("=", 1) for line in done.out.splitlines())
    assert lines["DB_USER"] == "web"
    assert lines["DB_PASSWORD"] == "********"
    assert lines["SESSION_KEY"] == "(not set)"
    assert mariadb.settings("web").password not in done.out


@pytest.mark.parametrize("command", ["web", "migrate", "show-settings"])
def test_wrong_setting_stops_every_start(
    run: Run, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    """One sentence with variable and value, no traceback."""
    monkeypatch.setenv("DB_PORT", "many")
    done = run(command)
    assert (done.status, done.err.count("\n")) == (1, 1)
    assert "cannot use DB_PORT='many'" in done.err


def test_migrate_says_what_it_did(
    run: Run, mariadb: MariaDb, monkeypatch: pytest.MonkeyPatch, sql_dir: Path
) -> None:
    """As account migrate; the range of ports is told too."""
    settings = mariadb.settings("migrate")
    monkeypatch.setenv("DB_USER", settings.user)
    monkeypatch.setenv("DB_PASSWORD", settings.password)
    monkeypatch.setenv("MIGRATIONS_DIR", str(sql_dir))
    monkeypatch.setenv("PORT_RANGE_LAST", "20199")
    done = run("migrate")
    assert done == (0, "applied: nothing was missing\nports for robots: 20000 to 20199\n", "")


def test_database_that_is_away_is_told_with_its_host(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An admin may know more than a visitor."""
    monkeypatch.setenv("DB_PORT", "1")
    done = run("robot", "list")
    assert done.status == 1
    assert "cannot reach the records" in done.err
    assert "127.0.0.1" in done.err


def test_web_becomes_gunicorn(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """With one worker that has threads, and our application."""
    monkeypatch.setenv("TICKET_KEY", "t" * 32)
    monkeypatch.setenv("WEB_SECRET_KEY", "w" * 32)
    started: list[list[str]] = []
    monkeypatch.setattr(os, "execv", lambda _, arguments: started.append(arguments))
    assert run("web").status == 0
    assert started[0][:3] == [sys.executable, "-m", "gunicorn"]
    assert {"--workers=1", "--worker-class=gthread", "--threads=8"} <= set(started[0])
    assert started[0][-1] == "robotether_server.web.wsgi:make_app()"


def test_help_lists_the_commands(run: Run) -> None:
    """Without any setting."""
    done = run("--help")
    assert done.status == 0
    listed = {line.split()[0] for line in done.out.splitlines() if line.startswith("  ")}
    people = {"user", "grant", "revoke", "token", "ssh-key", "ssh-config"}
    assert people | {"robot", "join-token", "rejected", "fleet", "audit"} <= listed
    assert {"migrate", "web", "show-settings"} <= listed

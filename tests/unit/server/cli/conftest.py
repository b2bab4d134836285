"""The command `robotether` in this process, against the real database."""

from __future__ import annotations

import sys
from collections.abc import Callable
from io import StringIO
from typing import NamedTuple

import pytest
from mariadb_server import MariaDb
from robotether_server.cli import main
from robotether_server.db import Database


class Done(NamedTuple):
    """What a command left behind."""

    status: int
    out: str
    err: str


Run = Callable[..., Done]


class Terminal(StringIO):
    """Standard input that somebody sits at."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def run(
    mariadb: MariaDb,
    database: Database,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> Run:
    """Run a command as in the web container; `stdin` is what it may read, `terminal` what a person types."""
    settings = mariadb.settings("web")
    for name, value in (
        ("DB_HOST", settings.host),
        ("DB_PORT", str(settings.port)),
        ("DB_USER", settings.user),
        ("DB_PASSWORD", settings.password),
    ):
        monkeypatch.setenv(name, value)

    def run_command(*arguments: str, stdin: str = "", terminal: str | None = None) -> Done:
        monkeypatch.setattr(sys, "argv", ["robotether", *map(str, arguments)])
        typed = StringIO(stdin) if terminal is None else Terminal(terminal)
        monkeypatch.setattr(sys, "stdin", typed)
        with pytest.raises(SystemExit) as ended:
            main()
        printed = capsys.readouterr()
        return Done(int(ended.value.code or 0), printed.out, printed.err)

    return run_command

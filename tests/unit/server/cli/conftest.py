"""The command `robotether` in this process, against the real database, and robots' sshds for `robotether fleet`."""

import sys
from functools import partial
from io import StringIO

import pytest
from admin_records import Done
from robotether_server.cli import main
from robotether_server.cli.fleet_ssh import Target
from shell_hosts import ShellNetwork


class Terminal(StringIO):
    """Standard input that somebody sits at."""

    def isatty(self):
        return True


def runner(monkeypatch, capsys):
    """Return what runs a command; `stdin` is what it may read, `terminal` what a person types."""

    def run_command(*arguments, stdin="", terminal=None):
        monkeypatch.setattr(sys, "argv", ["robotether", *map(str, arguments)])
        typed = StringIO(stdin) if terminal is None else Terminal(terminal)
        monkeypatch.setattr(sys, "stdin", typed)
        with pytest.raises(SystemExit) as ended:
            main()
        printed = capsys.readouterr()
        return Done(int(ended.value.code or 0), printed.out, printed.err)

    return run_command


@pytest.fixture
def run(mariadb, database, monkeypatch, capsys):
    settings = mariadb.settings("web")
    for name, value in (
        ("DB_HOST", settings.host),
        ("DB_PORT", str(settings.port)),
        ("DB_USER", settings.user),
        ("DB_PASSWORD", settings.password),
    ):
        monkeypatch.setenv(name, value)

    return runner(monkeypatch, capsys)


@pytest.fixture
def network(tmp_path):
    """A jump host, and the robots sim1 and sim2 behind it."""
    made = ShellNetwork(tmp_path)
    try:
        made.start("sim1", "sim2")
        yield made
    finally:
        made.stop()


@pytest.fixture
def run_fleet(monkeypatch, capsys):
    return partial(runner(monkeypatch, capsys), "fleet")


@pytest.fixture
def target(tmp_path):
    return Target(
        name="sim1",
        host="127.0.0.1",
        port=24000,
        user="ann",
        known_as="robotether-sim1",
        known_hosts=(tmp_path / "known_hosts",),
        identity_files=(),
        identities_only=True,
        connect_timeout_s=5,
    )

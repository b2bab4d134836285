"""Robots' sshds behind a jump host, and the command `robotether fleet` in this process, without a database."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from robotether_server.cli import main
from robotether_server.cli.fleet.ssh import Target
from shell_hosts import ShellNetwork


class Done(NamedTuple):
    """What a command left behind."""

    status: int
    out: str
    err: str


@pytest.fixture
def network(tmp_path: Path) -> Iterator[ShellNetwork]:
    """A jump host, and the robots sim1 and sim2 behind it."""
    made = ShellNetwork(tmp_path)
    try:
        made.start("sim1", "sim2")
        yield made
    finally:
        made.stop()


@pytest.fixture
def run_fleet(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., Done]:
    """Run `robotether fleet ...`."""

    def run(*arguments: object) -> Done:
        monkeypatch.setattr(sys, "argv", ["robotether", "fleet", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        printed = capsys.readouterr()
        return Done(int(ended.value.code or 0), printed.out, printed.err)

    return run


@pytest.fixture
def target(tmp_path: Path) -> Target:
    """A robot that nobody connects to."""
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

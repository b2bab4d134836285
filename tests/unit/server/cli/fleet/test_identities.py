"""The person's keys, from files and from a real ssh-agent."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from openssh_server import wait_until
from robotether_server.cli.fleet.identities import Identities
from robotether_server.cli.fleet.ssh_settings import Target
from shell_hosts import make_key


@pytest.fixture(autouse=True)
def agent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """An ssh-agent of the test's own, with no key yet."""
    socket = tmp_path / "agent"
    process = subprocess.Popen(["ssh-agent", "-D", "-a", str(socket)], stdout=subprocess.DEVNULL)
    try:
        wait_until(socket.exists, lambda: "ssh-agent listens")
        monkeypatch.setenv("SSH_AUTH_SOCK", str(socket))
        yield
    finally:
        process.terminate()
        process.wait(10)


def add_to_agent(path: Path) -> None:
    """Add a key, then leave only its public half."""
    subprocess.run(["ssh-add", "-q", str(path)], check=True, env=os.environ)
    path.unlink()


def offered(target: Target) -> list[str]:
    identities = Identities(target)
    try:
        sources = list(identities.get_sources())
        assert identities.tried == len(sources)
        assert all(source.username == target.user for source in sources)
        return [f"{source.pkey.get_name()} {source.pkey.get_base64()}" for source in sources]
    finally:
        identities.close()


def test_agents_keys_come_in_the_order_of_the_configuration(target: Target, tmp_path: Path) -> None:
    """The named one, then the agent's others, then files; so a server that allows three tries sees the best first."""
    lines = {name: make_key(tmp_path / name) for name in ("other", "named", "file")}
    add_to_agent(tmp_path / "other")
    add_to_agent(tmp_path / "named")
    files = (tmp_path / "file", tmp_path / "named", tmp_path / "missing")
    target = replace(target, identity_files=files, identities_only=False)
    assert offered(target) == [lines["named"], lines["other"], lines["file"]]
    assert offered(replace(target, identities_only=True)) == [lines["named"], lines["file"]]


def test_key_in_agent_and_file_is_offered_once(target: Target, tmp_path: Path) -> None:
    """By its public half."""
    line = make_key(tmp_path / "key")
    private = (tmp_path / "key").read_text()
    add_to_agent(tmp_path / "key")
    (tmp_path / "key").write_text(private)
    assert offered(replace(target, identity_files=(tmp_path / "key",))) == [line]


def test_locked_and_broken_files_are_passed_over(
    target: Target, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A key with a passphrase is remembered, for the sentence that tells of ssh-add."""
    make_key(tmp_path / "locked", "a passphrase")
    (tmp_path / "broken").write_text("rubbish")
    identities = Identities(
        replace(target, identity_files=(tmp_path / "locked", tmp_path / "broken"))
    )
    assert list(identities.get_sources()) == []
    identities.close()
    assert identities.locked == [tmp_path / "locked"]
    assert f"cannot use key {tmp_path}/broken" in caplog.text

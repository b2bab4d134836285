"""The check of a host's key: known, new, changed, revoked."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import paramiko
import pytest
from robotether_server.cli.fleet.host_keys import HostKeyCheck
from robotether_server.cli.fleet.problems import ConfigUnusable, HostKeyChanged, HostKeyUnknown
from robotether_server.cli.fleet.ssh_settings import Target
from shell_hosts import make_key


@pytest.fixture
def key(tmp_path: Path) -> paramiko.PKey:
    make_key(tmp_path / "host")
    return paramiko.PKey.from_path(tmp_path / "host")


def write(target: Target, *lines: str) -> None:
    target.known_hosts[0].write_text("".join(f"{line}\n" for line in lines))


def line(key: paramiko.PKey, name: str = "robotether-sim1") -> str:
    return f"{name} {key.get_name()} {key.get_base64()}"


def check(target: Target, key: paramiko.PKey, *, accept_new: bool = False) -> None:
    HostKeyCheck(target, accept_new=accept_new).missing_host_key(None, "[127.0.0.1]:24000", key)


def test_known_key_passes(target: Target, key: paramiko.PKey) -> None:
    """Under the alias, and never under the address, which all robots share."""
    write(target, line(key))
    check(target, key)
    write(target, line(key, "[127.0.0.1]:24000"))
    with pytest.raises(HostKeyUnknown):
        check(target, key)


def test_unknown_key_is_refused_with_its_fingerprint(target: Target, key: paramiko.PKey) -> None:
    """And nothing is noted."""
    with pytest.raises(
        HostKeyUnknown, match=r"sim1: its host key SHA256:\S+ .* robotether-sim1.*--accept-new"
    ):
        check(target, key)
    assert not target.known_hosts[0].exists()


def test_unknown_key_can_be_taken_and_is_known_then(target: Target, key: paramiko.PKey) -> None:
    """With --accept-new, once."""
    check(target, key, accept_new=True)
    check(target, key)
    assert target.known_hosts[0].read_text() == line(key) + "\n"


@pytest.mark.parametrize("accept_new", [False, True])
def test_changed_key_is_never_taken(
    target: Target, key: paramiko.PKey, tmp_path: Path, accept_new: bool
) -> None:
    """The sentence says how to forget the old one; the file stays as it is."""
    other = make_key(tmp_path / "other")
    write(target, f"robotether-sim1 {other}")
    before = target.known_hosts[0].read_text()
    with pytest.raises(HostKeyChanged, match="ssh-keygen -R 'robotether-sim1'"):
        check(target, key, accept_new=accept_new)
    assert target.known_hosts[0].read_text() == before


@pytest.mark.parametrize("accept_new", [False, True])
def test_revoked_key_is_never_taken(target: Target, key: paramiko.PKey, accept_new: bool) -> None:
    """Even where it is known as well."""
    write(target, line(key), f"@revoked {line(key, '*')}")
    with pytest.raises(HostKeyChanged, match="revoked"):
        check(target, key, accept_new=accept_new)


def test_host_shall_show_the_key_that_is_known(target: Target, key: paramiko.PKey) -> None:
    """Of several keys of a host only those types are asked for; of a new host any good one."""
    unwanted = HostKeyCheck(target, accept_new=False).unwanted_algorithms()
    assert unwanted == ["ssh-rsa", "ssh-dss"]
    write(target, "robotether-sim1 ssh-rsa AAAA")
    unwanted = HostKeyCheck(target, accept_new=False).unwanted_algorithms()
    assert "ssh-ed25519" in unwanted
    assert "rsa-sha2-512" not in unwanted


def test_new_key_needs_a_file(target: Target, key: paramiko.PKey) -> None:
    """A key that cannot be noted is not trusted."""
    with pytest.raises(ConfigUnusable, match="no UserKnownHostsFile"):
        check(replace(target, known_hosts=()), key, accept_new=True)

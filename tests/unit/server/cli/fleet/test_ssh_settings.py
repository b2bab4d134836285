"""How OpenSSH says that a robot is reached."""

from __future__ import annotations

from pathlib import Path

import pytest
from robotether_server.cli.fleet import ssh_settings
from robotether_server.cli.fleet.problems import ConfigUnusable

ENTRY = """
Host sim1
    HostName 127.0.0.1
    Port 24000
    HostKeyAlias robotether-sim1
    ProxyJump jump@gate.example:2222
Host *
    User ann
    IdentityFile ~/keys/one
    IdentitiesOnly yes
    UserKnownHostsFile ~/known
    GlobalKnownHostsFile none
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "config"
    path.write_text(ENTRY)
    return path


def test_robot_and_its_jump_host(config: Path) -> None:
    """Each has its own user, port, and name in known_hosts: an alias, or the address with its port."""
    target = ssh_settings.resolve("sim1", config)
    assert (target.host, target.port, target.user) == ("127.0.0.1", 24000, "ann")
    assert target.known_as == "robotether-sim1"
    assert target.known_hosts == (Path("~/known").expanduser(),)
    assert target.identity_files == (Path("~/keys/one").expanduser(),)
    assert (target.identities_only, target.connect_timeout_s) == (True, 10)
    assert target.jump is not None
    assert (target.jump.host, target.jump.port, target.jump.user) == ("gate.example", 2222, "jump")
    assert target.jump.known_as == "[gate.example]:2222"
    assert target.jump.jump is None


def test_several_jump_hosts_stand_in_line(config: Path) -> None:
    """The last one is the robot's own."""
    config.write_text("Host sim1\n    ProxyJump a.example,b.example:22\n    ConnectTimeout 3\n")
    target = ssh_settings.resolve("sim1", config)
    assert target.jump is not None
    assert target.jump.jump is not None
    assert (target.jump.known_as, target.jump.jump.known_as) == ("b.example", "a.example")
    assert target.connect_timeout_s == 3


def test_proxy_command_is_refused(config: Path) -> None:
    """A sentence says what to write instead."""
    config.write_text("Host sim1\n    ProxyCommand nc %h %p\n")
    with pytest.raises(ConfigUnusable, match=r"sim1: its entry has a ProxyCommand.*ProxyJump"):
        ssh_settings.resolve("sim1", config)


def test_mistake_in_the_file_is_told_in_the_words_of_ssh(config: Path) -> None:
    """With its line."""
    config.write_text("Host sim1\n    Prot 22\n")
    with pytest.raises(ConfigUnusable, match=r"(?s)cannot reach sim1: ssh says: .*line 2.*prot"):
        ssh_settings.resolve("sim1", config)


def test_no_ssh_here(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sentence says what to install."""
    monkeypatch.setenv("PATH", "")
    with pytest.raises(ConfigUnusable, match="install OpenSSH's client"):
        ssh_settings.resolve("sim1", config)

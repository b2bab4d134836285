"""How records look in answers."""

from __future__ import annotations

import datetime as dt
from pathlib import Path
from typing import Any

import pytest
from robotether_server.api import objects
from robotether_server.api.objects import shown_robot, ssh_of
from robotether_server.api.operations import plain
from robotether_server.db.robots import Report, Robot
from robotether_server.db.seen_robots import FREE, ControlState, DrivenBy, SeenRobot, Stopped
from robotether_server.problems import StoreUnavailable
from robotether_server.settings import JoinSettings

TIMESTAMP = dt.datetime(2026, 1, 1, 12, 3, 0, 900000, dt.UTC)
ROBOT = Robot(
    id=7,
    mac="00:1b:44:11:3a:b7",
    name="turtle",
    state="active",
    ros_port=20000,
    video_port=20001,
    fingerprint="SHA256:abc",
    settings={"shell_user": "pi"},
    site="lab",
    report=Report("turtle.local", "0.1.0", "192.0.2.1"),
    joined_at=TIMESTAMP,
)
SEEN = SeenRobot(ROBOT, True, TIMESTAMP, "drive", "198.51.100.9", "0.2.0")


def shown(control: ControlState | None, *, for_admin: bool) -> Any:
    """The robot as JSON has it."""
    return plain(shown_robot(SEEN, control, for_admin=for_admin))


def test_users_see_what_they_need_to_use_a_robot() -> None:
    """Neither its key nor where it is."""
    assert shown(FREE, for_admin=False) == {
        "name": "turtle",
        "mac": "00:1b:44:11:3a:b7",
        "state": "active",
        "online": True,
        "since": "2026-01-01T12:03:00Z",
        "level": "drive",
        "ros_port": 20000,
        "video_port": 20001,
        "shell_port": None,
        "settings": {"shell_user": "pi"},
        "site": "lab",
        "driver": None,
        "stopped": None,
    }


def test_driver_and_stop_have_the_names_of_the_control_object() -> None:
    """And are left out, rather than said to be nobody, for who may not know."""
    control = ControlState(DrivenBy("ann", TIMESTAMP), Stopped("ben", TIMESTAMP))
    seen = shown(control, for_admin=False)
    assert seen["driver"] == {"user": "ann", "since": "2026-01-01T12:03:00Z"}
    assert seen["stopped"] == {"by": "ben", "at": "2026-01-01T12:03:00Z"}
    assert not {"driver", "stopped"} & set(shown(None, for_admin=True))


def test_admins_see_more() -> None:
    """What the join told, and what the newest session does."""
    users = shown(FREE, for_admin=False)
    seen = shown(FREE, for_admin=True)
    assert {name: value for name, value in seen.items() if name not in users} == {
        "fingerprint": "SHA256:abc",
        "hostname": "turtle.local",
        "agent_version": "0.2.0",
        "join_address": "192.0.2.1",
        "joined_at": "2026-01-01T12:03:00Z",
        "address": "198.51.100.9",
        "rotate_key": False,
    }


def test_robot_is_told_where_its_tunnel_goes(tmp_path: Path) -> None:
    """Not before sshd has its keys."""
    settings = JoinSettings("approve", 3, "robots.example", (2222, 443), tmp_path, False)
    with pytest.raises(StoreUnavailable):
        ssh_of(settings)
    (tmp_path / "ssh_host_ed25519_key.pub").write_text("ssh-ed25519 AAAA root@sshd\n")
    assert plain(ssh_of(settings)) == {
        "user": "tunnel",
        "host": "robots.example",
        "ports": [2222, 443],
        "host_keys": ["ssh-ed25519 AAAA"],
    }


def test_public_keys_are_read_without_their_comments(tmp_path: Path) -> None:
    """By file name, and only *.pub."""
    (tmp_path / "b.pub").write_text("ssh-rsa BBBB root@x\n")
    (tmp_path / "a.pub").write_text("ssh-ed25519 AAAA\n")
    (tmp_path / "a").write_text("PRIVATE")
    assert objects.read_host_keys(tmp_path) == ["ssh-ed25519 AAAA", "ssh-rsa BBBB"]


@pytest.mark.parametrize("name", ["empty.pub", "other.txt"])
def test_no_key_yet_is_said_so(tmp_path: Path, name: str) -> None:
    """A robot must not be told to trust nothing."""
    (tmp_path / name).write_text("")
    with pytest.raises(StoreUnavailable, match="host keys"):
        objects.read_host_keys(tmp_path)

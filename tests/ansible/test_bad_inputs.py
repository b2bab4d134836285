"""What is wrong with an enrolment is said in a sentence with what to do, leaves nothing behind, and can be mended."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from playbooks import Played, Site
from robot_hosts import RobotHost, RobotHosts

# The server is there and its SSH is not.
NO_WAY = {"robotether_agent_settings": {"ssh_ports": [1]}, "robotether_agent_connect_timeout": 5}
OTHERS_KEY = "ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIF5OqWkLrTgxgaQxOsLkZq9mGzN1VYQ2b5sPaX3nJd8u"


@pytest.fixture(scope="module")
def robot(site: Site, hosts: RobotHosts, wheelhouse: Path) -> RobotHost:
    """A machine that every test of this module fails to enrol."""
    site.variables["agent_wheelhouse"] = str(wheelhouse)
    return hosts.boot("unlucky")


@pytest.fixture(autouse=True)
def _leaves_nothing(robot: RobotHost, site: Site) -> Iterator[None]:
    """Whatever fails, robot and server are afterwards as they were before."""
    files, rows = robot.footprint(), _rows(site)
    yield
    assert robot.footprint() ^ files == set()
    assert _rows(site) == rows


def _rows(site: Site) -> list[list[str]]:
    return site.stack.sql("SELECT name, mac, state, fingerprint FROM robots")


def _refused(site: Site, robot: RobotHost, *, undone: bool = False, **variables: Any) -> Played:
    """Play enroll.yml, which must fail with a sentence of ours; `undone`: after it had begun to change things."""
    played = site.play("enroll.yml", robot, **variables)
    assert played.code != 0, played.printed
    assert played.recaps[robot.name].unreachable == 0, played.printed
    said = (
        f"What this run had changed on {robot.name} is undone" if undone else "Nothing was changed"
    )
    assert said in played.text, played.printed
    return played


# --- what is found before anything is changed ---


@pytest.mark.parametrize(
    ("variables", "sentence"),
    [
        ({"robotether_agent_server": "127.0.0.1:1"}, "this robot cannot reach https://127.0.0.1:1"),
        ({"robotether_agent_server": "https://x/"}, "allowed is HOST or HOST:PORT, without https://"),
        ({"robotether_agent_server": ""}, "robotether_agent_server is not set"),
        ({"robotether_agent_tls_fingerprint": "ab" * 32}, "has the SHA-256"),
        ({"robotether_agent_tls_fingerprint": "rubbish"}, "64 hexadecimal digits"),
        ({"robotether_agent_tls_fingerprint": ""}, "is not trusted here"),
        ({"token": ""}, "there is no token; export ROBOTETHER_TOKEN"),
        ({"robotether_agent_mac": "00:1b:44:11:3a:b7"}, "leave one out"),
    ],
)  # fmt: skip
def test_wrong_variable(
    site: Site, robot: RobotHost, variables: dict[str, str], sentence: str
) -> None:
    """A variable that cannot work is named."""
    assert sentence in _refused(site, robot, **variables).text


def test_wrong_token(site: Site, robot: RobotHost) -> None:
    """A token that the server does not know is refused before anything is changed, with what to do."""
    played = site.play("enroll.yml", robot, token="rt_wrong")
    assert "set ROBOTETHER_TOKEN (or robotether_agent_token)" in played.text
    assert "[token_invalid]" in played.text


@contextmanager
def _broken(robot: RobotHost, breaking: str, mending: str) -> Iterator[None]:
    robot.run(breaking)
    try:
        yield
    finally:
        robot.run(mending)


# A command that says it is an older Python; Ansible's own modules are not reached with it.
OLD_PYTHON = (
    "mv /usr/bin/python3 /usr/bin/python3.kept; printf '#!/bin/sh\\necho 3.9.2\\n' > /usr/bin/python3; "
    "chmod 755 /usr/bin/python3"
)


@pytest.mark.parametrize(
    ("breaking", "mending", "sentence"),
    [
        ("mv /usr/bin/python3 /usr/bin/python3.kept", "mv /usr/bin/python3.kept /usr/bin/python3",
         "it has no python3; install it"),
        (OLD_PYTHON, "mv -f /usr/bin/python3.kept /usr/bin/python3",
         "its Python is 3.9.2 and the agent needs 3.10"),
        ("mount -t tmpfs -o size=20m tmpfs /opt", "umount /opt", "20 MB free and the agent needs 150 MB"),
        ("mount -t tmpfs -o size=1g,ro tmpfs /opt", "umount /opt", "is mounted read-only"),
        ("systemctl stop sim-robot", "systemctl start sim-robot", "rosbridge does not answer at ws://127.0.0.1:9090"),
    ],
)  # fmt: skip
def test_unfit_machine(
    site: Site, robot: RobotHost, breaking: str, mending: str, sentence: str
) -> None:
    """A machine that cannot run an agent, or has nothing to drive, is left alone and told why."""
    with _broken(robot, breaking, mending):
        assert sentence in _refused(site, robot).text


def test_no_systemd(site: Site, hosts: RobotHosts) -> None:
    """A machine with another init is refused."""
    sshd = "ssh-keygen -A && mkdir -p /run/sshd && exec /usr/sbin/sshd -D"
    plain = hosts.boot("plain", command=["bash", "-c", sshd])
    plain.wait("SSH answers", plain.greets)
    assert "it does not run systemd" in _refused(site, plain).text


def test_no_docker(site: Site, robot: RobotHost) -> None:
    """agent_runtime=docker on a machine without Docker says what to do."""
    assert "there is no Docker that runs" in _refused(site, robot, agent_runtime="docker").text


# --- what only the server, or the agent, can tell ---


def test_join_token_wrong_expired_used_up(site: Site, robot: RobotHost) -> None:
    """Each way in which a join token is no good has its own sentence, and what was installed is undone."""
    expired, used_up = site.join_token(uses=1), site.join_token(uses=1)
    site.stack.sql(
        "UPDATE join_tokens SET expires_at = NOW() - INTERVAL 1 DAY ORDER BY id DESC LIMIT 2"
    )
    site.stack.sql(
        "UPDATE join_tokens SET expires_at = NOW() + INTERVAL 1 DAY, used = uses ORDER BY id DESC LIMIT 1"
    )
    for token, code in (
        ("rj_wrong", "token_invalid"),
        (expired, "token_expired"),
        (used_up, "token_used_up"),
    ):
        played = _refused(site, robot, undone=True, token=token)
        assert f"[{code}]" in played.text
        assert "make a new token" in played.text or code == "token_invalid"


@pytest.mark.parametrize(
    ("variables", "sentence"),
    [
        ({"robotether_agent_mac": "rubbish"}, "is not a MAC address"),
        ({"robotether_agent_mac": "01:00:5e:00:00:01"}, "multicast"),
        ({"robotether_agent_mac": "02:00:00:00:00:07"}, "locally administered"),
        ({"robotether_agent_interface": "wlan7"}, "it has no interface wlan7"),
    ],
)
def test_mac_rubbish(
    site: Site, robot: RobotHost, variables: dict[str, str], sentence: str
) -> None:
    """An address that can name no robot is refused by the agent's own rule."""
    variables = {"robotether_agent_interface": "", **variables}
    assert sentence in _refused(site, robot, undone=True, **variables).text


@contextmanager
def _other_robot(site: Site, name: str, mac: str) -> Iterator[None]:
    bearer = {"Authorization": f"Bearer {site.token}"}
    path = f"/api/v1/robots/{name}"
    status, answer = site.stack.request("PUT", path, {"mac": mac, "public_key": OTHERS_KEY}, bearer)
    assert status == 201, answer
    try:
        yield
    finally:
        site.stack.request("DELETE", path, headers=bearer)


def test_mac_in_use(site: Site, robot: RobotHost) -> None:
    """Another robot's key holds this MAC: it goes on, and this one is told both reasons there can be."""
    with _other_robot(site, robot.name, robot.mac):
        text = _refused(site, robot, undone=True).text
    assert "[mac_in_use]" in text
    assert "robotether robot rekey" in text


def test_name_in_use(site: Site, robot: RobotHost) -> None:
    """Another robot has the name already."""
    with _other_robot(site, robot.name, "00:1b:44:ff:ff:01"):
        text = _refused(site, robot, undone=True).text
    assert "choose another robotether_agent_name" in text


def test_no_way_to_ssh(site: Site, robot: RobotHost) -> None:
    """A tunnel that does not come up takes service, row and key back."""
    assert "cannot reach" in _refused(site, robot, undone=True, **NO_WAY).text


def test_after_all_that_the_right_run_finishes(site: Site, robot: RobotHost) -> None:
    """The same machine is enrolled at once when everything is right, and a failed change later keeps it as it was."""
    with ExitStack() as at_the_end:
        at_the_end.callback(lambda: site.play_well("retire.yml", robot, retire_confirm="true"))
        site.play_well("enroll.yml", robot)
        before = robot.footprint()
        _refused(site, robot, undone=True, **NO_WAY)
        assert robot.footprint() ^ before == set()
        robot.wait("online again", lambda: site.stack.online(robot.name))

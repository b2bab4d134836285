"""What is wrong with an enrolment is said in a sentence with what to do, and leaves nothing behind.

All cases are played at once, as a site with many robots would meet them, each on a machine of its own, or, where it
ends before a look at the machine or with no more than that, on one that the inventory has under all their names.
"""

import re
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from typing import Any

import pytest
from playbooks import Played

# What the install line says of the same faults, and takes back, is played with every change.
pytestmark = pytest.mark.release

SSHD_ALONE = "ssh-keygen -A && mkdir -p /run/sshd && exec /usr/sbin/sshd -D"
OTHERS_KEY = "ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAI" + "F5O" * 14 + "F"
# The server is there and its SSH is not.
NO_WAY = {"robotether_agent_settings": {"ssh_ports": [1]}, "robotether_agent_connect_timeout": 5}
HIDE_PYTHON = "mv /usr/bin/python3 /usr/bin/python3.kept"
SHOW_PYTHON = "mv -f /usr/bin/python3.kept /usr/bin/python3"
# A command that says it is an older Python; Ansible's own modules are not reached with it.
OLD_PYTHON = f"{HIDE_PYTHON}; printf '#!/bin/sh\\necho 3.9.2\\n' > /usr/bin/python3; chmod 755 /usr/bin/python3"
NOTHING_CHANGED = "Nothing was changed"
UNDONE = "is undone"


@dataclass(frozen=True)
class Case:
    """One thing that is wrong: variables, or the machine (`breaks` until `mends`), and what is said about it."""

    says: tuple[str, ...]
    variables: dict[str, Any] = field(default_factory=dict)
    breaks: str = "true"
    mends: str = "true"
    options: dict[str, Any] = field(default_factory=dict)
    ends: str = NOTHING_CHANGED

    @property
    def needs_own_machine(self):
        """Whether something is done to the machine, by the test or by the playbook before it takes it back."""
        return self.ends != NOTHING_CHANGED or self.breaks != "true" or bool(self.options)


def _wrong(variable, value, *says, **more):
    return Case(says, {f"robotether_agent_{variable}": value}, **more)


# Found before anything is changed.
LOOKED = {
    "unreachable": _wrong("server", "127.0.0.1:1", "this robot cannot reach https://127.0.0.1:1", "check its network"),
    "no-address": _wrong("server", "https://x/", "allowed is HOST or HOST:PORT, without https://"),
    "no-server": _wrong("server", "", "robotether_agent_server is not set"),
    "other-tls": _wrong("tls_fingerprint", "ab" * 32, "has the SHA-256", "compare both with the one"),
    "no-tls": _wrong("tls_fingerprint", "rubbish", "64 hexadecimal digits"),
    "no-token": _wrong("token", "", "there is no token; export ROBOTETHER_TOKEN"),
    "wrong-token": _wrong("token", "rt_wrong", "set ROBOTETHER_TOKEN", "[token_invalid]"),
    "open-token": _wrong("settings", {"token": "rt_wrong"}, "could read; export ROBOTETHER_TOKEN instead"),
    "no-docker": _wrong("runtime", "docker", "there is no Docker that runs", "use venv"),
    "no-python": Case(("it has no python3; install it",), breaks=HIDE_PYTHON, mends=SHOW_PYTHON),
    "old-python": Case(("its Python is 3.9.2 and the agent needs 3.10",), breaks=OLD_PYTHON, mends=SHOW_PYTHON),
    "full-disk": Case(("20 MB free and the agent needs 150 MB", "make room"),
                      breaks="mount -t tmpfs -o size=20m tmpfs /opt", mends="umount /opt"),
    "read-only": Case(("is mounted read-only",), breaks="mount -t tmpfs -o size=1g,ro tmpfs /opt", mends="umount /opt"),
    "no-rosbridge": Case(("rosbridge does not answer at ws://127.0.0.1:9090", "start it"),
                         breaks="systemctl stop sim-robot", mends="systemctl start sim-robot"),
    "no-systemd": Case(("it does not run systemd",), options={"command": ["bash", "-c", SSHD_ALONE]}),
}  # fmt: skip

# Known to the agent or the server alone, after the installation: all of that is taken back. One of each kind, as each
# costs an installation: what else agent and server refuse, their own tests have.
UNDO = {
    "wrong-join": _wrong("token", "rj_wrong", "[token_invalid]", "set ROBOTETHER_TOKEN", ends=UNDONE),
    "expired": _wrong("token", "(made in the test)", "[token_expired]", "make a new token", ends=UNDONE),
    "no-interface": _wrong("interface", "wlan7", "it has no interface wlan7", ends=UNDONE),
    "mac-in-use": Case(("[mac_in_use]", "robotether robot rekey"), ends=UNDONE),
    "name-in-use": Case(("choose another robotether_agent_name",), ends=UNDONE),
    "no-ssh": Case(("cannot reach",), NO_WAY, ends=UNDONE),
}  # fmt: skip
CASES = {**LOOKED, **UNDO}


@dataclass
class Bad:
    left_behind: dict[str, set[str]]
    rows: list[str]
    played: Played

    def said(self, name):
        """The sentence about one machine."""
        end = r"(?:PLAY RECAP|fatal:|failed: \[|TASK|$)"
        found = re.findall(rf"cannot \w+ {name}: .*?{end}", self.played.text)
        assert found, self.played.printed
        return str(found[-1])


@pytest.fixture(scope="module")
def bad(site, hosts):
    """What was said of each case, and what it left on its machine."""
    by_name = _boot(hosts)
    machines = list(hosts.booted)
    variables = {name: dict(case.variables) for name, case in CASES.items()}
    variables["expired"] |= _expired_token(site)
    with ExitStack() as mending:
        _add_others(site, by_name, mending.callback)
        for name, case in CASES.items():
            by_name[name].run(case.breaks)
            mending.callback(by_name[name].run, case.mends)
        before = [machine.footprint() for machine in machines]
        played = site.play("enroll.yml", *by_name.values(), per_robot=variables)
        changed = {
            id(machine.container): machine.footprint() ^ was
            for machine, was in zip(machines, before, strict=True)
        }
    left = {name: changed[id(machine.container)] for name, machine in by_name.items()}
    for machine in machines:
        hosts.remove(machine)
    rows = [row[0] for row in site.stack.sql("SELECT name FROM robots")]
    return Bad(left, rows, played)


def _boot(hosts):
    own = {name: case.options for name, case in CASES.items() if case.needs_own_machine}
    *alone, shared = hosts.boot_all(*own, "shared", options=own)
    for machine in (*alone, shared):
        # One has no systemd, and nobody has waited for its sshd, which makes its keys first.
        machine.wait("SSH answers", machine.greets, 60)
    by_name = {machine.name: machine for machine in alone}
    return {name: by_name.get(name) or replace(shared, name=name) for name in CASES}


def _expired_token(site):
    token = site.join_token(uses=1)
    site.stack.sql(
        "UPDATE join_tokens SET expires_at = NOW() - INTERVAL 1 DAY ORDER BY id DESC LIMIT 1"
    )
    return {"robotether_agent_token": token}


def _add_others(site, machines, at_the_end):
    """Rows of other robots that have the MAC or the name of one of these; they go when that is mended."""
    bearer = {"Authorization": f"Bearer {site.token}"}
    others = {
        "name-in-use": ("00:1b:44:ff:ff:01", OTHERS_KEY[:-1] + "G"),
        "stranger": (machines["mac-in-use"].mac, OTHERS_KEY),
    }
    for name, (mac, key) in others.items():
        path = f"/api/v1/robots/{name}"
        body = {"mac": mac, "public_key": key}
        status, answer = site.stack.request("PUT", path, body, bearer)
        assert status == 201, answer
        at_the_end(site.stack.request, "DELETE", path, headers=bearer)


@pytest.mark.parametrize("name", CASES)
def test_says_what_is_wrong_and_leaves_nothing_behind(bad, name):
    said = bad.said(name)
    for part in (*CASES[name].says, CASES[name].ends):
        assert part in said, said
    assert bad.left_behind[name] == set()
    assert name not in bad.rows


def test_failed_change_keeps_a_robot_as_it_was(site, hosts):
    """A setting that cuts an enrolled robot off is taken back, and the robot is online as before."""
    robot = hosts.boot("kept")
    site.play_well("enroll.yml", robot)
    # The relay writes down that a robot came a moment after its tunnel stands.
    robot.wait("online", lambda: site.stack.online(robot.name))
    before = robot.footprint()
    played = site.play("enroll.yml", robot, **NO_WAY)
    assert played.code != 0
    played.must_say("cannot reach", UNDONE)
    assert robot.footprint() ^ before == set()
    robot.wait("online again", lambda: site.stack.online(robot.name))

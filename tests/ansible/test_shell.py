"""A person's shell on a robot behind NAT, through the whole stack: ssh, scp, rsync, Ansible and robotether fleet."""

import json
import os
import re
import shutil
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest
from commands import output_of_command, run_command
from openssh_server import make_key, wait_until
from playbooks import ANSIBLE, invite
from robot_hosts import ROOT, USER, WHEELHOUSE
from stack import Stack

NAME = "turtle"
PERSON = "ann"


@dataclass
class Person:
    """Somebody with a machine of her own, an SSH key and a token; all she has of the server is what its API says."""

    folder: Path
    stack: Stack
    token: str

    @property
    def config(self):
        return self.folder / "ssh_config"

    @property
    def environment(self):
        """No agent and no keys of whoever runs the tests."""
        packages = os.pathsep.join(str(ROOT / name) for name in ("common", "server"))
        own = {"HOME": str(self.folder), "PYTHONPATH": packages}
        return {**os.environ, **own, "SSH_AUTH_SOCK": ""}

    def ask(self, method, path, body=None):
        headers = {"Authorization": f"Bearer {self.token}"}
        status, answer = self.stack.request(method, path, body, headers)
        assert status in (200, 201), answer
        return answer

    def write_config(self):
        """What the server prints, with her own key and files."""
        entries = self.ask("GET", "/api/v1/ssh-config")
        own = (
            f"Host *\n    IdentityFile {self.folder}/id\n    IdentitiesOnly yes\n"
            f"    UserKnownHostsFile {self.folder}/known_hosts\n    GlobalKnownHostsFile /dev/null\n"
            # In place of a yes at the terminal, to the server's key and the robot's. Fleet wants its own yes.
            "    StrictHostKeyChecking accept-new\n"
        )
        self.config.write_text(f"{entries}{own}")

    def run(self, *command):
        return run_command(*command, env=self.environment)

    def run_well(self, *command):
        return output_of_command(*command, env=self.environment)

    def fleet(self, *arguments):
        fleet = (sys.executable, "-m", "robotether_server.cli", "fleet", "run")
        return self.run(*fleet, *arguments, "--ssh-config", str(self.config))


@pytest.fixture(scope="module")
def turtle(stack, hosts, token):
    """A robot with a real sshd, made by the install line and approved by an admin; its shell is on."""
    robot = hosts.boot(NAME)
    line = re.sub(r" --token \S+", "", invite(stack, token)["command"])
    options = f"--interface eth0 --wheelhouse {WHEELHOUSE} --no-video"
    said = robot.run(f"{line} {options}")
    assert 'video_encoder = "off"' in robot.run("cat /etc/robotether/agent.toml")
    key = robot.run("ssh-keygen -lf /var/lib/robotether-agent/id_ed25519.pub").split()[1]
    # Which key to compare, and how to approve it.
    assert key in said
    assert "robot approve" in said
    [[name]] = stack.sql(f"SELECT name FROM robots WHERE mac = '{robot.mac}'")
    stack.robotether("robot", "approve", name, "--fingerprint", key)
    stack.admin.ask("PATCH", f"/robots/{name}", {"name": NAME})
    stack.robotether("robot", "shell", NAME, "on")
    stack.robotether("robot", "set", NAME, "--shell-user", USER)
    return robot


@pytest.fixture(scope="module")
def ann(stack, turtle, tmp_path_factory):
    """A person who manages the robot, has an account there, and has uploaded her key."""
    folder = tmp_path_factory.mktemp("ann")
    public = make_key(folder / "id")
    stack.robotether("user", "add", PERSON)
    stack.robotether("grant", PERSON, NAME, "manage")
    turtle.run(f"cat >> /home/{USER}/.ssh/authorized_keys", stdin=public)
    person = Person(folder, stack, stack.token("laptop", PERSON))
    person.ask("POST", "/api/v1/me/ssh-keys", {"name": "laptop", "public_key": public})
    person.write_config()
    return person


@pytest.fixture(scope="module")
def known(ann):
    """The same, after her first login, at which she has accepted both host keys."""
    log_in = partial(ann.run, "ssh", "-F", ann.config, NAME, "true")
    # The robot opens its forward when it hears that the shell is on.
    wait_until(lambda: log_in().returncode == 0, lambda: log_in().stderr)
    return ann


def test_fleet_trusts_no_host_that_she_has_not_seen(ann):
    """The fleet trusts no unknown host, not even the server; this runs before her first login."""
    done = ann.fleet("true", "--on", NAME)
    assert done.returncode == 1
    assert "--accept-new" in done.stderr


def test_ssh_runs_on_the_robot(known, turtle):
    said = known.run_well("ssh", "-F", known.config, NAME, "id -un; hostname")
    assert said.split() == [USER, turtle.name]


def test_scp_and_rsync_carry_files(known, turtle, tmp_path):
    sent = tmp_path / "sent"
    sent.write_bytes(os.urandom(3_000_000))
    known.run_well("scp", "-q", "-F", known.config, sent, f"{NAME}:by_scp")
    assert shutil.which("rsync"), "rsync is missing here: tools/ensure_test_hosts"
    by_ssh = f"ssh -F {known.config}"
    known.run_well("rsync", "-e", by_ssh, f"{NAME}:by_scp", tmp_path / "back")
    assert (tmp_path / "back").read_bytes() == sent.read_bytes()


def test_ansible_pings_it_from_the_inventory(known, site):
    inventory = known.folder / "fleet.yml"
    inventory.write_text(
        "plugin: robotether.robotether.robots\n"
        f"server: 127.0.0.1:{known.stack.https_port}\n"
        f"tls_fingerprint: {site.fingerprint}\n"
        f"token: {known.token}\n"
    )
    own = known.folder / "own_config"
    own.write_text("".join(known.config.read_text().partition("Host *\n")[1:]))
    ansible = Path(sys.executable).with_name("ansible")
    arguments = ("-i", inventory, "robots", "-m", "ansible.builtin.ping", "--playbook-dir", ANSIBLE)
    said = known.run_well(ansible, *arguments, "--ssh-extra-args", f"-F {own}")
    assert re.search(rf'^{NAME} \| SUCCESS.*"ping": "pong"', said, re.DOTALL | re.MULTILINE)


def test_fleet_runs_on_it(known):
    done = known.fleet("id -un", "--on", "*", "--json")
    assert [(row["robot"], row["stdout"]) for row in json.loads(done.stdout)] == [
        (NAME, f"{USER}\n")
    ]
    assert known.fleet("id -un", "--on", "*", "--sudo").stdout == f"{NAME} | root\n"
    done = known.fleet("exit 3", "--on", NAME)
    assert done.returncode == 1
    assert "exit status 3" in done.stderr


def test_time_out_ends_the_command_on_the_robot(known, turtle):
    command = "echo started; sleep 4321; true"
    done = known.fleet(command, "--on", NAME, "--sudo", "--timeout", "3")
    assert done.stdout == f"{NAME} | started\n"
    assert "timed out after 3 s" in done.stderr
    turtle.wait("the command has ended", lambda: not turtle.succeeds("pgrep -f 'sleep 432[1]'"), 10)

"""Runs playbooks of ansible/ or of the installed collection as a site's administrator does; reads what they say."""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from commands import output_of_command, run_command
from robot_hosts import (
    ROOT,
    VIDEO_WHEELHOUSE,
    WHEELHOUSE,
    RobotHost,
    RobotHosts,
)
from stack import Stack

ANSIBLE = ROOT / "ansible"
# A robot's pip gets what the agent needs from a folder that the tests' hosts have, which costs neither the network nor
# a copy of each wheel; PyAV, which is large, from another one, or not at all.
FROM_WHEELS = {"PIP_NO_INDEX": "1", "PIP_FIND_LINKS": WHEELHOUSE}
WITH_VIDEO = {**FROM_WHEELS, "PIP_FIND_LINKS": f"{WHEELHOUSE} {VIDEO_WHEELHOUSE}"}
# Some two minutes are usual for twenty hosts on two cores; this is for a playbook that hangs.
ENDS_WITHIN_S = 1200
RECAP = re.compile(r"^(\S+)\s+: ok=\d+\s+changed=(\d+)", re.MULTILINE)


def pip_environment() -> dict[str, str]:
    """This process's environment, in which pip trusts what SSL_CERT_FILE names, as tools/common.sh has it."""
    bundle = os.environ.get("SSL_CERT_FILE")
    return {**os.environ, **({"PIP_CERT": bundle} if bundle else {})}


def build_wheel(agent: Path, folder: Path) -> Path:
    """Build a wheel of an agent's sources, with its requirements beside it, as robotether_wheel_file wants it."""
    sources = folder / "agent"
    left_out = shutil.ignore_patterns("build", "*.egg-info", "__pycache__")
    shutil.copytree(agent, sources, ignore=left_out)
    shutil.copytree(ROOT / "common", folder / "common", ignore=left_out)
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps"]
    command += ["--wheel-dir", str(folder), str(sources)]
    output_of_command(*command, env=pip_environment())
    shutil.copy(sources / "requirements.txt", folder)
    return next(folder.glob("*.whl"))


def invite(stack: Stack, token: str, name: str = "", uses: int = 1) -> dict[str, str]:
    # Names of tokens are unique.
    body = {"name": name or f"join-{time.monotonic_ns()}", "uses": uses, "hours": 1}
    headers = {"Authorization": f"Bearer {token}", "Host": f"cloud:{stack.https_port}"}
    status, answer = stack.request("POST", "/api/v1/join-tokens", body, headers)
    assert status == 201, answer
    return dict(answer)


@dataclass(frozen=True)
class Played:
    code: int
    printed: str

    @property
    def changed(self) -> dict[str, int]:
        return {host: int(count) for host, count in RECAP.findall(self.printed)}

    @property
    def text(self) -> str:
        """What it printed, with all white space as single blanks, so that a sentence is found across lines."""
        return " ".join(self.printed.replace("\\\n", "\n").split())

    def must_say(self, *sentences: str) -> None:
        """Fail the test, with all that was printed, unless each of these stands in it."""
        for sentence in sentences:
            assert sentence in self.text, f"{sentence!r} is not in:\n{self.printed}"


@dataclass
class Site:
    """An administrator's machine: the inventory, the server's address, and a token.

    With `collections` the playbooks are those that are installed there, and not the checkout's.
    """

    folder: Path
    stack: Stack
    hosts: RobotHosts
    token: str
    collections: Path | None = None

    @property
    def server(self) -> str:
        return f"{self.hosts.server_host}:{self.stack.https_port}"

    @property
    def fingerprint(self) -> str:
        """The SHA-256 of the server's certificate, as nginx has it."""
        printed = self.stack.exec(
            "nginx", "openssl", "x509", "-in", "/run/nginx/tls/cert.pem", "-noout", "-fingerprint", "-sha256",
        )  # fmt: skip
        return printed.strip().split("=")[-1].replace(":", "").lower()

    def join_token(self, *, uses: int) -> str:
        return invite(self.stack, self.token, uses=uses)["token"]

    def inventory(
        self, robots: Iterable[RobotHost], per_robot: Mapping[str, Mapping[str, Any]]
    ) -> Path:
        """Write the inventory of these robots, as a site's robots.ini; `per_robot` are variables by name."""
        ours = {
            "robotether_agent_server": self.server,
            "robotether_agent_tls_fingerprint": self.fingerprint,
            # A container's interface is virtual, so the agent's rule finds none by itself.
            "robotether_agent_interface": "eth0",
            "robotether_agent_environment": str(FROM_WHEELS),
        }
        lines = [
            "[robots]",
            *(robot.inventory_line(**per_robot.get(robot.name, {})) for robot in robots),
            "",
            "[robots:vars]",
            *(f"{name}={value}" for name, value in ours.items()),
        ]
        path = self.folder / "robots.ini"
        path.write_text("\n".join(lines) + "\n")
        return path

    def play(
        self,
        playbook: str,
        *robots: RobotHost,
        check: bool = False,
        verbosity: int = 0,
        per_robot: Mapping[str, Mapping[str, Any]] | None = None,
        **extra: Any,
    ) -> Played:
        """Run a playbook on these robots; `extra` are variables (-e), and `token` the one of this run."""
        environment = {
            **os.environ,
            **self._place(),
            "ANSIBLE_NOCOLOR": "1",
            "ANSIBLE_VERBOSITY": str(verbosity),
            "ROBOTETHER_TOKEN": extra.pop("token", self.token),
        }
        command = [
            str(Path(sys.executable).with_name("ansible-playbook")),
            "-i", str(self.inventory(robots, per_robot or {})),
            *(["--check"] if check else []),
            "-e", json.dumps(extra),
            playbook,
        ]  # fmt: skip
        folder = self.folder if self.collections else ANSIBLE
        done = run_command(*command, cwd=folder, env=environment, limit_s=ENDS_WITHIN_S)
        return Played(done.returncode, done.stdout + done.stderr)

    def _place(self) -> dict[str, str]:
        if self.collections:
            return {"ANSIBLE_COLLECTIONS_PATH": str(self.collections)}
        return {"ANSIBLE_CONFIG": str(ANSIBLE / "ansible.cfg")}

    def play_well(self, playbook: str, *robots: RobotHost, **extra: Any) -> Played:
        played = self.play(playbook, *robots, **extra)
        assert played.code == 0, played.printed
        return played

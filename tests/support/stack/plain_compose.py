"""A stack as a newcomer starts it: `docker compose up` in a copy of the repository, and no other program.

Its images have a tag of their own, so that nothing but this copy can have made them.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import urllib.error
import uuid
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

from commands import output_of_command, run_command
from documented import tracked
from local_network import free_port
from logins import Login
from openssh_server import wait_until

ROOT = Path(__file__).resolve().parents[3]
PASSWORD = re.compile(r"password  (\S+)")


class PlainCompose:
    """A copy of this checkout, with a name and ports of its own on the command line."""

    def __init__(self, folder: Path, ports_of: PlainCompose | None = None) -> None:
        """With `ports_of`, this stack replaces another: the same images at the same address."""
        self._folder = folder / "robotether"
        self._name = f"robotether-test-{uuid.uuid4().hex[:8]}"
        self._programs = folder / "programs"
        self.settings: dict[str, object] = {
            "COMPOSE_PROJECT_NAME": self._name,
            "TAG": self._name,
            "HTTP_PORT": free_port(),
            "HTTPS_PORT": free_port(),
            "SSH_PORT": free_port(),
            "CA_BUNDLE": os.environ.get("SSL_CERT_FILE", ""),
        }
        if ports_of is not None:
            names = ("TAG", "HTTP_PORT", "HTTPS_PORT", "SSH_PORT")
            self.settings |= {name: ports_of.settings[name] for name in names}
        self._copy()

    @property
    def compose_folder(self) -> Path:
        return self._folder / "compose"

    @property
    def url(self) -> str:
        return f"https://localhost:{self.settings['HTTPS_PORT']}/"

    def run(self, *arguments: str, timeout: float = 600) -> CompletedProcess[str]:
        environment = {name: str(value) for name, value in self.settings.items()}
        environment |= {"PATH": str(self._programs), "HOME": os.environ["HOME"]}
        words = ("docker", "compose", *arguments)
        return run_command(*words, cwd=self.compose_folder, env=environment, limit_s=timeout)

    def tool(self, name: str, *arguments: str) -> str:
        settings = {name: str(value) for name, value in self.settings.items()}
        environ = os.environ | settings
        return output_of_command(self._folder / name, *arguments, env=environ, limit_s=600)

    def compose(self, *arguments: str) -> str:
        done = self.run(*arguments)
        if done.returncode != 0:
            raise AssertionError(
                f"docker compose {' '.join(arguments)} exited {done.returncode}\n{done.stdout[-4000:]}\n"
                f"{done.stderr[-4000:]}\n{self.run('logs', '--tail', '40').stdout[-8000:]}"
            )
        return done.stdout

    def states(self) -> dict[str, str]:
        """Service -> `healthy`, `exited 0` or whatever else its container is."""
        listed = self.compose("ps", "--all", "--format", "{{json .}}").splitlines()
        found = {row["Service"]: row for row in map(json.loads, listed)}
        return {
            name: item["Health"] or f"{item['State']} {item['ExitCode']}"
            for name, item in found.items()
        }

    def log(self, service: str) -> str:
        return self.compose("logs", "--no-log-prefix", service)

    def robots(self) -> dict[str, dict[str, Any]]:
        listed = self.compose("exec", "-T", "web", "robotether", "robot", "list", "--json")
        return {row["name"]: row for row in json.loads(listed)}

    def wait(
        self, what: str, condition: Callable[[], object], *services: str, seconds: float = 60
    ) -> None:
        wait_until(
            condition, lambda: f"{what}\n{self.compose('logs', *services)}", seconds, every_s=0.5
        )

    def accepts_login(self, password: str) -> bool:
        """Whether the log-in form takes this password for admin, and then shows who is logged in."""
        try:
            login = Login(self.url.rstrip("/"), "admin", password)
        except urllib.error.HTTPError as refused:
            refused.close()
            return False
        return login.is_in and "admin" in login.page

    def down(self, *, images: bool = True) -> None:
        """Remove containers, networks and volumes, and images unless another stack has them."""
        also = ["--rmi", "all"] if images else []
        self.run("--profile", "*", "down", "--volumes", "--timeout", "5", *also)

    def _copy(self) -> None:
        """Copy what git has or would take, and make a folder of programs that has docker alone."""
        for path in tracked():
            copy = self._folder / path.relative_to(ROOT)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, copy)
        self._programs.mkdir()
        docker = shutil.which("docker")
        assert docker is not None
        (self._programs / "docker").symlink_to(docker)

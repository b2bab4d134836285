"""The running demo as experiments and screenshots see it: its containers, its address, an API token, tickets.

Needs `make demo`, and changes nothing of it but for one API token, which ends after a day.
"""

from __future__ import annotations

import json
import subprocess
import time
from functools import cached_property
from http import HTTPStatus
from pathlib import Path
from typing import Any

import docker
from docker.models.containers import Container
from docker_engine import address_of, container_of, machine_address
from local_network import request_json

ROOT = Path(__file__).resolve().parents[3]
TOKEN_NAME = "bench"


def _run_compose(*arguments: str) -> str:
    command = [str(ROOT / "tools" / "compose"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


class Demo:
    """The compose project that `make demo` started."""

    def __init__(self) -> None:
        self.engine = docker.from_env()

    def compose(self, *arguments: str) -> str:
        return _run_compose("--profile", "*", *arguments)

    def robotether(self, *arguments: str) -> str:
        return self.compose("exec", "-T", "web", "robotether", *arguments)

    @cached_property
    def project(self) -> str:
        return str(json.loads(self.compose("config", "--format", "json"))["name"])

    def container(self, service: str) -> Container:
        return container_of(self.engine, self.project, service)

    def address_of(self, service: str) -> str:
        """The address of a service's container, which this machine reaches and nobody else does."""
        return address_of(self.container(service))

    @cached_property
    def address(self) -> str:
        """HOST:PORT of https at which the published ports answer as they do to the network."""
        return f"{machine_address(self.engine)}:{self.https_port}"

    @cached_property
    def https_port(self) -> int:
        return int(self.compose("port", "nginx", "8443").rsplit(":", 1)[1])

    @property
    def url(self) -> str:
        return f"https://{self.address}"

    @cached_property
    def admin_password(self) -> str:
        """The password of the user admin, unless somebody has changed it."""
        folder = _run_compose("--env", "SECRETS_DIR").strip() or "secrets"
        return (ROOT / "compose" / folder / "admin_password").read_text()

    @cached_property
    def token(self) -> str:
        name = f"{TOKEN_NAME}-{int(time.time())}"
        return self.robotether(
            "token", "create", "--user", "admin", "--name", name, "--days", "1"
        ).split()[-1]

    def ask(self, method: str, path: str, body: dict[str, object] | None = None) -> Any:
        """One request to the server's API; the parsed answer. Raises ConnectionError for an error's."""
        headers = {"Authorization": f"Bearer {self.token}"}
        status, answer = request_json(method, f"{self.url}{path}", body, headers)
        if status >= HTTPStatus.BAD_REQUEST:
            raise ConnectionError(f"cannot {method} {path}: {status} {answer}")
        return answer

    def ticket(self, robot: str, mode: str) -> str:
        return str(self.ask("POST", "/api/v1/tickets", {"robot": robot, "mode": mode})["ticket"])

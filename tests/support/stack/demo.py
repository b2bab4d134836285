"""A server that runs on this machine, as experiments and screenshots see it: its containers, address, API and tickets.

`Demo` needs `make demo`, and changes nothing of it except an API token, which is deleted at the end.
"""

from __future__ import annotations

import atexit
import json
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cached_property
from http import HTTPStatus
from pathlib import Path
from typing import Any

import docker
from commands import output_of_command
from docker.models.containers import Container
from docker_engine import address_of, container_of, machine_address
from inside import output_of
from local_network import request_json

ROOT = Path(__file__).resolve().parents[3]
# The container's own, whatever it is published as.
HTTPS = "8443/tcp"
ANSWERS_WITHIN_S = 30


class LiveServer(ABC):
    def __init__(self) -> None:
        self.engine = docker.from_env()

    @abstractmethod
    def container(self, service: str) -> Container:
        pass

    @cached_property
    def machine(self) -> str:
        """This machine's address for published ports, also from other networks of it."""
        return machine_address(self.engine)

    @cached_property
    def address(self) -> str:
        """HOST:PORT of https at which the published ports answer as they do to the network."""
        ports = self.container("nginx").attrs["NetworkSettings"]["Ports"]
        return f"{self.machine}:{ports[HTTPS][0]['HostPort']}"

    @property
    def url(self) -> str:
        return f"https://{self.address}"

    def exec(self, service: str, *command: str) -> str:
        return output_of(service, self.container(service), *command)

    def robotether(self, *arguments: str) -> str:
        return self.exec("web", "robotether", *arguments)

    @cached_property
    def token(self) -> str:
        return self.token_of("admin")

    def token_of(self, user: str, name: str = "") -> str:
        name = name or f"experiments-{time.monotonic_ns()}"
        created = self.robotether("token", "create", "--user", user, "--name", name, "--days", "2")
        return created.split()[-1]

    def ask(self, method: str, path: str, body: Mapping[str, object] | None = None) -> Any:
        """One request to /api/v1 + `path`; the parsed answer. Raises ConnectionError for an error's."""
        headers = {"Authorization": f"Bearer {self.token}"}
        url = f"{self.url}/api/v1{path}"
        status, answer = request_json(method, url, body, headers, ANSWERS_WITHIN_S)
        if status >= HTTPStatus.BAD_REQUEST:
            raise ConnectionError(f"cannot {method} {path}: status {status}: {answer!s:.500}")
        return answer

    def ticket(self, robot: str, mode: str) -> str:
        return str(self.ask("POST", "/tickets", {"robot": robot, "mode": mode})["ticket"])


class Demo(LiveServer):
    def container(self, service: str) -> Container:
        return container_of(self.engine, self._project, service)

    def address_of(self, service: str) -> str:
        """The address of a service's container, which this machine reaches and nobody else does."""
        return address_of(self.container(service))

    @cached_property
    def token(self) -> str:
        name = f"bench-{time.monotonic_ns()}"
        atexit.register(self.robotether, "token", "delete", "--user", "admin", "--name", name)
        return self.token_of("admin", name)

    @cached_property
    def admin_password(self) -> str:
        """The password of the user admin, unless somebody has changed it."""
        folder = _run_compose("--env", "SECRETS_DIR").strip() or "secrets"
        return (ROOT / "compose" / folder / "admin_password").read_text()

    @cached_property
    def _project(self) -> str:
        return str(json.loads(_run_compose("config", "--format", "json"))["name"])


def _run_compose(*arguments: str) -> str:
    return output_of_command(ROOT / "tools" / "compose", *arguments)

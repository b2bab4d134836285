"""The running stack that image and end-to-end tests use: a project of its own beside any demo on this machine.

`Stack.up()` is `tools/up --demo` with other ports, secrets and volumes; `Stack.down()` removes all of it. The tests
ask the daemons through `exec`, and hurt single containers through the engine's SDK (`container`).
"""

from __future__ import annotations

import os
import time
import urllib.error
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property, partial
from http import HTTPStatus
from pathlib import Path
from typing import Any, TypeVar

import docker
import image_names
from commands import output_of_command
from docker.models.containers import Container
from docker_engine import container_of
from inside import output_of
from local_network import free_port, request_json
from logins import Login
from openssh_server import wait_until
from robotether_server.settings import robot as robot_settings

# One HTTPS request to the stack: method, path, body and headers.
Request = Callable[[str, str, dict[str, Any] | None, dict[str, str]], tuple[int, Any]]


class Admin:
    """The stack's admin by the API: the command `robotether` would start a Python for each change, some 0.8 s."""

    def __init__(self, request: Request, make_token: Callable[[str], str]) -> None:
        self._request = request
        self._make_token = make_token
        self._token: str | None = None

    def try_to(self, method: str, path: str, body: dict[str, Any] | None = None) -> tuple[int, Any]:
        return self._try_to(method, f"/api/v1{path}", body)

    def sees(self, path: str) -> bool:
        """Tell whether a path of the site, such as that of a picture, gives something now."""
        return self._try_to("GET", path, None)[0] == HTTPStatus.OK

    def ask(self, method: str, path: str, body: dict[str, Any] | None = None) -> Any:
        status, answer = self.try_to(method, path, body)
        assert status < HTTPStatus.BAD_REQUEST, f"{method} {path} got {status}: {answer}"
        return answer

    def users(self) -> set[str]:
        return {user["name"] for user in self.ask("GET", "/users")["users"]}

    def add_user(self, name: str, password: str | None = None) -> str:
        given = {} if password is None else {"password": password}
        answer = self.ask("POST", "/users", {"name": name, "role": "user", **given})
        return password or str(answer["password"])

    def remove(self, kind: str, name: str) -> None:
        self.ask("DELETE", f"/{kind}/{name}")

    def grant(self, user: str, robot: str, level: str) -> bool:
        given = {"user": user, "robot": robot, "level": level}
        status, answer = self.try_to("POST", "/grants", given)
        assert status in {HTTPStatus.OK, HTTPStatus.CREATED}, answer
        return status == HTTPStatus.CREATED

    def set_robot(self, robot: str, changes: Mapping[str, Any]) -> None:
        """Change settings by their paths, such as `page.kind`; None takes one back to its default."""
        settings = self.ask("GET", f"/robots/{robot}")["settings"]
        for path, value in changes.items():
            if value is None:
                settings = robot_settings.remove_path(settings, path)
            else:
                settings = robot_settings.put_path(settings, path, value)
        self.ask("PATCH", f"/robots/{robot}", {"settings": settings})

    def _try_to(self, method: str, path: str, body: dict[str, Any] | None) -> tuple[int, Any]:
        status, answer = self._send(method, path, body)
        if status == HTTPStatus.UNAUTHORIZED:
            # A test has removed all tokens.
            self._token = None
            status, answer = self._send(method, path, body)
        return status, answer

    def _send(self, method: str, path: str, body: dict[str, Any] | None) -> tuple[int, Any]:
        if self._token is None:
            self._token = self._make_token(f"stack-{time.monotonic_ns()}")
        return self._request(method, path, body, {"Authorization": f"Bearer {self._token}"})


ROOT = Path(__file__).resolve().parents[3]
# Two runs beside each other are two projects.
PROJECT = f"robotether-test-{os.getpid()}"
# The site whose pages may connect to this stack's robots, for tests of pages of others.
LAB = "https://lab.example"
# An agent that was kept out asks again within 30 s, and opens the way for its pictures after that for its commands.
BACK_WITHIN_S = 90
T = TypeVar("T")


@dataclass
class Stack:
    """A compose project with ports that are free on this machine, clear of a demo on the standard ones."""

    folder: Path
    http_port: int = field(default_factory=free_port)
    https_port: int = field(default_factory=free_port)
    ssh_port: int = field(default_factory=free_port)
    engine: docker.DockerClient = field(default_factory=docker.from_env)
    project: str = PROJECT
    # The sources whose tools and settings these are, and what goes before the settings.
    root: Path = ROOT
    variables: dict[str, str] = field(default_factory=dict)
    # More lines of its .env: what makes it a cell of a site.
    settings: dict[str, object] = field(default_factory=dict)
    # Two stacks that start at once need not look for changes again.
    is_built: bool = image_names.ARE_BUILT

    @property
    def url(self) -> str:
        return f"https://localhost:{self.https_port}"

    @property
    def env_file(self) -> Path:
        return self.folder / "test.env"

    @property
    def admin_password(self) -> str:
        """The first admin's, which `tools/up` makes at the first machine of a site."""
        return self._admin_password.read_text()

    @property
    def _admin_password(self) -> Path:
        return self.folder / "secrets" / "admin_password"

    def up(self, *, robots: bool = True) -> None:
        self.write_settings()
        built = ["--no-build"] if self.is_built else []
        self.tool("tools/up", *(["--demo"] if robots else []), *built, timeout=1500)

    def write_settings(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        example = (self.root / "compose" / ".env.example").read_text()
        ours = {
            "COMPOSE_PROJECT_NAME": self.project,
            "HTTP_PORT": self.http_port,
            "HTTPS_PORT": self.https_port,
            "SSH_PORT": self.ssh_port,
            "SECRETS_DIR": self.folder / "secrets",
            "ALLOWED_ORIGINS": LAB,
            # Unlike the demo's, the robots of the tests are alike.
            **{f"SIM{number}_KIND": "differential" for number in (1, 2, 3)},
            **{f"SIM{number}_CAMERAS": 2 for number in (1, 2, 3)},
            # No test needs more, and each frame is drawn, sent and shown with the processors of the tests.
            "SIM_CAMERA_FPS": 5,
            **self.settings,
        }
        lines = [line for line in example.splitlines() if line.split("=")[0] not in ours]
        lines += [f"{name}={value}" for name, value in ours.items()]
        self.env_file.write_text("\n".join(lines) + "\n")

    def down(self) -> None:
        self.compose("--profile", "*", "down", "--volumes", "--timeout", "5", timeout=120)

    def tool(self, *command: str, timeout: float = 60) -> str:
        env_file = os.path.relpath(self.env_file, self.root)
        environment = {**os.environ, "ENV_FILE": env_file, **self.variables}
        return output_of_command(*command, cwd=self.root, env=environment, limit_s=timeout)

    def compose(self, *arguments: str, timeout: float = 60) -> str:
        return self.tool("tools/compose", *arguments, timeout=timeout)

    def exec(self, service: str, *command: str, user: str = "") -> str:
        return output_of(service, self.container(service), *command, user=user)

    def robotether(self, *arguments: str) -> str:
        return self.exec("web", "robotether", *arguments)

    def sql(self, query: str) -> list[list[str]]:
        printed = self.exec(
            "mysql",
            "mariadb",
            "--batch",
            "--skip-column-names",
            "robotether",
            "-e",
            query,
            user="root",
        )
        return [line.split("\t") for line in printed.splitlines()]

    def container(self, service: str) -> Container:
        return container_of(self.engine, self.project, service)

    def logs(self, *services: str, lines: int = 40) -> str:
        return self.compose("--profile", "*", "logs", "--no-color", "--tail", str(lines), *services)

    def wait(self, what: str, condition: Callable[[], T], *services: str, seconds: float = 30) -> T:
        """Wait until the condition gives something true; on a time-out show the services' logs."""

        def report() -> str:
            return f"{what}\n{self.logs(*services) if services else ''}"

        return wait_until(condition, report, seconds, every_s=0.1)

    def wait_for_right(self, user: str, robot: str) -> None:
        """Wait until the relay, which looks for new rights once a second, has seen this one."""
        headers = {"Authorization": f"Bearer {self.token(f'right-{time.monotonic_ns()}', user)}"}
        path = f"/api/v1/robots/{robot}/control"
        self.wait(
            f"{user} sees {robot}",
            lambda: self.request("GET", path, headers=headers)[0] == HTTPStatus.OK,
            "relay",
        )

    def wait_for_changes(self, robot: str) -> None:
        """Wait until the relay knows all that was changed so far: a right that comes last is read with the rest.

        A connection that is opened before ends with what the relay then reads of its robot's policy.
        """
        witness = f"witness-{time.monotonic_ns()}"
        self.admin.add_user(witness)
        self.admin.grant(witness, robot, "observe")
        self.wait_for_right(witness, robot)
        self.admin.remove("users", witness)

    def wait_until_free(self, robot: str) -> None:
        """Wait until nobody drives: the relay hears a moment later that a test before has closed its browser."""
        self.wait(f"{robot} free", lambda: self._control_if_free(robot), "relay")

    def wait_until_drivable(self, robot: str) -> None:
        """Wait until a robot is there with its guard and nobody drives: a test before may have cut it off."""
        self.wait(
            f"{robot} drivable",
            # Of a robot that is offline nobody knows the guard.
            lambda: self._control_if_free(robot).get("guard") == "ready",
            robot,
            "relay",
            seconds=60,
        )

    def _control_if_free(self, robot: str) -> dict[str, Any]:
        """What the relay says of the robot's control, when nobody drives and it is kept for nobody; else nothing."""
        status, control = self.admin.try_to("GET", f"/robots/{robot}/control")
        is_free = status == HTTPStatus.OK and not (control["driver"] or control["reserved"])
        return control if is_free else {}

    def wait_healthy(self, service: str, seconds: float = 60) -> None:
        self.wait(
            f"{service} healthy",
            lambda: (
                self.container(service).attrs["State"].get("Health", {}).get("Status") == "healthy"
            ),
            service,
            seconds=seconds,
        )

    def request(
        self,
        method: str,
        path: str,
        body: dict[str, Any] | None = None,
        headers: dict[str, str] | None = None,
    ) -> tuple[int, Any]:
        return request_json(method, self.url + path, body, headers)

    def token(self, name: str, user: str = "admin") -> str:
        """A new API token, which a login of admin makes: no token may make another."""
        # The first machine of a site alone has the password.
        if not self._admin_password.exists():
            return self.robotether("token", "create", "--user", user, "--name", name).split()[-1]
        token = {"name": name, "user": user}
        try:
            return str(self._login.create("/tokens", token)["token"])
        except urllib.error.HTTPError as refused:
            with refused:
                if refused.code != HTTPStatus.UNAUTHORIZED:
                    raise
        # A test has ended all logins.
        del self._login
        return str(self._login.create("/tokens", token)["token"])

    def online(self, robot: str) -> bool:
        try:
            status, answer = self.admin.try_to("GET", f"/robots/{robot}")
        except OSError:
            return False
        return status == HTTPStatus.OK and bool(answer["online"])

    @cached_property
    def _login(self) -> Login:
        return Login(self.url, "admin", self.admin_password)

    @cached_property
    def admin(self) -> Admin:
        return Admin(self.request, self.token)


def wait_until_back(stack: Stack, *robots: str) -> None:
    for robot in robots:
        is_back = partial(_is_back, stack, robot)
        stack.wait(f"{robot} back", is_back, robot, "sshd", "relay", seconds=BACK_WITHIN_S)


def _is_back(stack: Stack, robot: str) -> bool:
    try:
        status, control = stack.admin.try_to("GET", f"/robots/{robot}/control")
        if status != HTTPStatus.OK or control["guard"] != "ready":
            return False
        return stack.admin.sees(f"/robots/{robot}/video/snapshot?topic=/camera/image_raw")
    except OSError:
        return False


@contextmanager
def database_away(stack: Stack) -> Iterator[None]:
    """Stop the database inside the block; after it the next test finds it, and a relay that reads it, as ever."""
    mysql = stack.container("mysql")
    mysql.stop(timeout=20)
    try:
        yield
    finally:
        mysql.start()
        stack.wait_healthy("mysql")
        # A relay that is still trying to reach the one that is gone hears of changes seconds late.
        stack.wait_for_changes("sim1")

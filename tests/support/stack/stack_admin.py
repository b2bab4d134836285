"""What a test changes as the admin of its stack, through the API.

The command `robotether` would do the same and start a Python for each change, some 0.8 s of a processor that browser
and robots of the test need; what the command itself does, its own tests and those of the images say.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from http import HTTPStatus
from typing import Any, Protocol

from robotether_server.settings import robot as robot_settings


class Request(Protocol):
    """One HTTPS request to the stack."""

    def __call__(
        self, method: str, path: str, body: dict[str, Any] | None, headers: dict[str, str]
    ) -> tuple[int, Any]: ...


class Admin:
    """The stack's admin with a token of its own, made when it is first needed."""

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
        """Add a user who is not an admin; the password, which the server makes unless there is one."""
        given = {} if password is None else {"password": password}
        answer = self.ask("POST", "/users", {"name": name, "role": "user", **given})
        return password or str(answer["password"])

    def remove(self, kind: str, name: str) -> None:
        self.ask("DELETE", f"/{kind}/{name}")

    def grant(self, user: str, robot: str, level: str) -> bool:
        """Give a user a level on a robot; whether there was no grant of theirs before."""
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

"""Programs that ask the REST API, each with the API token of a user."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from robot_signer import RobotSigner
from robotether_server.db import Database
from web_visitor import SITE, Browser, bearer
from werkzeug.test import TestResponse

API = "/api/v1"


@dataclass
class Program:
    visitor: Browser
    headers: dict[str, str]

    def ask(self, method: str, path: str, body: Any = None) -> TestResponse:
        """Send one request; `path` goes on after /api/v1, and a body is sent as JSON."""
        sent = {} if body is None else {"json": body}
        return self.visitor.ask(method, API + path, headers=self.headers, **sent)

    def get(self, path: str) -> Any:
        answer = self.ask("GET", path)
        assert answer.status_code == 200, answer.text
        return answer.json

    def refused(self, method: str, path: str, body: Any = None) -> tuple[int, str]:
        """Status and code of a refusal, which must be a problem in JSON."""
        answer = self.ask(method, path, body)
        assert answer.content_type == "application/problem+json", answer.text
        assert answer.json is not None, answer.text
        return answer.status_code, answer.json["code"]


def program_of(visitor: Browser, database: Database, user: str) -> Program:
    return Program(visitor, bearer(database, user))


def in_person(visitor: Browser, name: str) -> Program:
    visitor.log_in(name)
    csrf = visitor.csrf_of("/profile")
    return Program(visitor, {"X-CSRFToken": csrf, "Referer": f"{SITE}/profile"})


def new_public_key() -> str:
    return RobotSigner().line

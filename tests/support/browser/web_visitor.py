"""Visitors of web for its tests: a browser or a program behind nginx, in Flask's own client."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from argon2 import PasswordHasher
from flask import Flask
from flask.testing import FlaskClient
from robotether_server.db import Database, credentials, users
from robotether_server.settings.server import (
    DatabaseSettings,
    JoinSettings,
    SiteAddressSettings,
    TicketSettings,
    WebSettings,
)
from werkzeug.test import TestResponse

PASSWORD = "a long enough password"
# By parameters that cost no time; a hash names its own.
HASH = PasswordHasher(time_cost=1, memory_cost=8, parallelism=1).hash(PASSWORD)
SITE = "https://robots.example"


def web_settings_of(database: DatabaseSettings, folder: Path) -> WebSettings:
    return WebSettings(
        database=database,
        tickets=TicketSettings("t" * 32, 30),
        join=JoinSettings("approve", 3, None, (2222, 443), folder / "host_keys", True),
        site_address=SiteAddressSettings(None, 443, ("127.0.0.1", 1)),
        agent_files_dir=folder / "agent",
        secret_key="w" * 32,
        login_ttl_h=12,
        login_idle_h=4,
        wall_robots=20,
        log_level="info",
    )


def write_host_key(folder: Path) -> None:
    (folder / "host_keys").mkdir()
    key = "ssh-ed25519 AAAAhost root@sshd\n"
    (folder / "host_keys" / "ssh_host_ed25519_key.pub").write_text(key)


@dataclass
class Browser:
    client: FlaskClient
    # Token of the forms of its pages, which holds as long as its login.
    form_token: str = ""

    def ask(self, method: str, path: str, **options: Any) -> TestResponse:
        headers = {"X-Forwarded-For": "198.51.100.7", "X-Forwarded-Proto": "https"}
        headers |= options.pop("headers", {})
        return self.client.open(path, method=method, base_url=SITE, headers=headers, **options)

    def csrf(self) -> str:
        return self.csrf_of("/login")

    def csrf_of(self, path: str) -> str:
        page = self.ask("GET", path, follow_redirects=True).text
        found = re.search(r'name="csrf-token" content="([^"]+)"', page)
        assert found, page
        return found[1]

    def log_in(self, name: str, password: str = PASSWORD, onward: str = "") -> TestResponse:
        form = {"csrf_token": self.csrf(), "name": name, "password": password, "next": onward}
        self.form_token = ""
        return self.ask("POST", "/login", data=form)


def bearer(database: Database, user: str) -> dict[str, str]:
    with database.transaction() as tx:
        text = credentials.create_token(tx, users.get(tx, user), "test", None)
    return {"Authorization": f"Bearer {text}"}


def audit_kinds(database: Database) -> list[tuple[str, str, str | None]]:
    with database.transaction() as tx:
        rows = tx.rows("SELECT kind, actor, address FROM audit_events ORDER BY id")
    return [(row["kind"], row["actor"], row["address"]) for row in rows]


def paths(app: Flask, start: str, method: str, name: str = "", number: str = "1") -> list[str]:
    """Every path below `start` that takes the method, of sim1 and ann or of what has this name and number."""
    found = []
    for rule in app.url_map.iter_rules():
        if rule.rule.startswith(start) and method in (rule.methods or ()):
            path = re.sub(r"<int:\w+>", number, rule.rule)
            for part, usual in (("name", "sim1"), ("robot", "sim1"), ("user", "ann")):
                path = path.replace(f"<{part}>", name or usual)
            assert "<" not in path, path
            found.append(path)
    return found

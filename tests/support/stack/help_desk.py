"""Operators, a manager and robots in the real database, whose clock a test moves on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from granted import give
from robotether_server.contract.audit import AuditEvent
from robotether_server.db import (
    Database,
    Transaction,
    audit,
    fleet,
    operators,
    requests,
    robots,
    users,
)
from robotether_server.db.audit import Source
from robotether_server.db.control import NewLease, next_fence
from robotether_server.db.requests import HelpRequest
from robotether_server.services import operators as operator_service
from robotether_server.services import requests as request_service
from robotether_server.services.operators import Choice, QueueView
from robotether_server.times import utc_now

CLOCKS = {
    "help_requests": ("created_at", "offer_until", "accepted_at", "closed_at", "waits_since"),
    "help_request_passes": ("passed_at",),
    "operators": ("last_seen_at", "idle_since", "wrap_up_until"),
    "planner": ("planned_at",),
}


class HelpDesk:
    """Robots sim1 and sim2; ann and ben drive both, mona manages both, olga observes sim1, zoe has no right."""

    def __init__(self, database: Database, relay_database: Database) -> None:
        self.database = database
        self.relay_database = relay_database
        with database.transaction() as tx:
            self.robots = {}
            for number, name in enumerate(("sim1", "sim2")):
                self.robots[name] = robots.add(tx, f"02:00:00:00:52:0{number}", name)
                robots.set_state(tx, self.robots[name], "active")
            self.users = {
                name: users.add(tx, name, "x", "user")
                for name in ("ann", "ben", "mona", "olga", "zoe")
            }
            for robot_id in self.robots.values():
                give(tx, self.users["ann"], robot_id, "drive")
                give(tx, self.users["ben"], robot_id, "drive")
                give(tx, self.users["mona"], robot_id, "manage")
            give(tx, self.users["olga"], self.robots["sim1"], "observe")
        self.pass_time(60)

    def ask(
        self, robot: str = "sim1", source: str = "robot", priority: int = 2, pool: str = ""
    ) -> int:
        with self.relay_database.transaction() as tx:
            request_id, _ = fleet.ask_for_help(
                tx,
                self.robots[robot],
                source=source,
                reason="stuck",
                priority=priority,
                pool=pool,
            )
        assert request_id is not None
        return request_id

    def poll(self, name: str, choice: Choice | None = "available") -> QueueView:
        with self.database.transaction() as tx:
            return operator_service.poll(tx, users.get(tx, name), choice)

    def act(self, action: str, name: str, *values: Any) -> HelpRequest:
        with self.database.transaction() as tx:
            act = getattr(request_service, action)
            request: HelpRequest = act(tx, Source(name), users.get(tx, name), *values)
            return request

    def pass_time(self, seconds: float) -> None:
        with self.database.transaction() as tx:
            for table, columns in CLOCKS.items():
                changes = ", ".join(f"{name} = {name} - INTERVAL %(s)s SECOND" for name in columns)
                tx.change(f"UPDATE {table} SET {changes}", {"s": seconds})

    def drive(self, name: str, robot: str, shown_as: str = "") -> None:
        with self.relay_database.transaction() as tx:
            user_id, driver = self.users[name], shown_as or name
            next_fence(tx, NewLease(self.robots[robot], user_id, driver, utc_now()))

    def request(self, request_id: int) -> HelpRequest:
        with self.database.transaction() as tx:
            return requests.get(tx, self.users["mona"], request_id).request

    def events(self, kind: str | None = None) -> list[AuditEvent]:
        with self.database.transaction() as tx:
            return audit.find(tx, audit.AuditSearch(kind=kind))[::-1]

    def set_pools(self, name: str, *pools: str) -> None:
        with self.database.transaction() as tx:
            operators.set_pools(tx, self.users[name], pools)

    @contextmanager
    def transaction(self) -> Iterator[Transaction]:
        with self.database.transaction() as tx:
            yield tx

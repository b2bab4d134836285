"""Robots that ask to join, as web's own join handler asks for them, against the real database."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass
from pathlib import Path

from robotether_common.join import PreviousKey
from robotether_server.contract.audit import AuditEvent
from robotether_server.db import (
    Database,
    Transaction,
    audit,
    credentials,
    join_tokens,
    robots,
    seen_robots,
    users,
)
from robotether_server.db.robots import Report, RobotRow
from robotether_server.identity import PublicKey
from robotether_server.services import joining
from robotether_server.services.joining import Answer, PresentedKey
from robotether_server.settings.server import JoinSettings

MAC = "00:1b:44:00:61:01"
OTHER_MAC = "00:1b:44:00:61:02"
KEY = PublicKey("ssh-ed25519 AAAA", "SHA256:a")
OTHER_KEY = PublicKey("ssh-ed25519 BBBB", "SHA256:b")
REPORT = Report("turtle", "0.1.0", "192.0.2.1")


@dataclass(frozen=True)
class Site:
    database: Database
    policy: str = "approve"
    limit: int = 3
    local: bool = False

    def ask(
        self,
        mac: str = MAC,
        key: PublicKey = KEY,
        *,
        report: Report = REPORT,
        token: str | None = None,
        name: str | None = None,
        mac_present: bool = True,
        previous: PreviousKey | None = None,
        is_proven: bool = True,
    ) -> Answer:
        request = joining.JoinAttempt(
            PresentedKey(mac, key, report), token, name, mac_present, previous
        )
        with self.database.transaction() as tx:
            answer = joining.is_in(tx, request)
        if answer is None:
            with self.database.transaction() as tx:
                answer = joining.join(tx, request, self.rules, is_proven=is_proven)
        return answer

    @property
    def rules(self) -> JoinSettings:
        return JoinSettings(self.policy, self.limit, None, (2222,), Path(), self.local)

    def unknown_robot(self, number: int, address: str = "192.0.2.1") -> Answer:
        report = Report("turtle", "0.1.0", address)
        return self.ask(f"00:1b:44:01:00:{number:02x}", key(number), report=report)

    def announce(self, name: str = "sim1", mac: str = MAC) -> None:
        with self.database.transaction() as tx:
            robots.add(tx, mac, name)

    def robot(self, name: str) -> RobotRow:
        with self.database.transaction() as tx:
            return robots.get(tx, name)

    def set_state(self, name: str, state: str) -> None:
        with self.database.transaction() as tx:
            robots.set_state(tx, robots.get(tx, name).id, state)  # type: ignore[arg-type] # tests choose states

    def admins_token(self) -> str:
        with self.database.transaction() as tx:
            users.add(tx, "root", "x", "admin")
            return credentials.create_token(tx, users.get(tx, "root"), "test", None)

    def join_token(self, uses: int, hours: float = 1) -> str:
        ends_at = dt.datetime.now(dt.UTC) + dt.timedelta(hours=hours)
        with self.database.transaction() as tx:
            return join_tokens.create(tx, "lab", uses, ends_at, "root")

    def used(self) -> int:
        with self.database.transaction() as tx:
            return join_tokens.list_all(tx)[0].used

    def claimed(self) -> list[str]:
        with self.database.transaction() as tx:
            waiting = robots.list_waiting(tx)
        return [key.fingerprint for key in waiting if key.reason == "mac_in_use"]

    def names(self) -> list[str]:
        with self.database.transaction() as tx:
            return [seen.robot.name for seen in seen_robots.list_all(tx)]

    def events(self, kind: str | None = None) -> list[AuditEvent]:
        with self.database.transaction() as tx:
            return audit.find(tx, audit.AuditSearch(kind=kind))[::-1]


def key(number: int) -> PublicKey:
    return PublicKey(f"ssh-ed25519 {number}", f"SHA256:{number}")


def age(tx: Transaction, hours: int) -> None:
    tx.change("UPDATE robots SET joined_at = joined_at - INTERVAL %s HOUR", (hours,))
    tx.change("UPDATE key_claims SET claimed_at = claimed_at - INTERVAL %s HOUR", (hours,))

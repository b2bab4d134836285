"""The enrolment lock: one transaction at a time, until its connection closes."""

from __future__ import annotations

import threading

import pytest
from robotether_server.db import Database, locks
from robotether_server.problems import StoreUnavailable


def test_second_one_waits_for_the_firsts_commit(database: Database) -> None:
    """And sees what the first one wrote."""
    seen: list[int] = []

    def count() -> None:
        with database.transaction() as tx:
            locks.enrolment(tx)
            seen.append(len(tx.rows("SELECT * FROM robots")))

    second = threading.Thread(target=count)
    with database.transaction() as tx:
        locks.enrolment(tx)
        locks.enrolment(tx)
        second.start()
        tx.insert("INSERT INTO robots (mac, name) VALUES ('00:1b:44:11:3a:b7', 'a')")
        second.join(0.3)
        assert seen == []
    second.join(20)
    assert seen == [1]


def test_who_waits_too_long_is_told_to_try_again(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody waits for ever behind a transaction that hangs."""
    monkeypatch.setattr(locks, "WAIT_S", 0)
    with database.transaction() as first, database.transaction() as second:
        locks.enrolment(first)
        with pytest.raises(StoreUnavailable, match="try again"):
            locks.enrolment(second)

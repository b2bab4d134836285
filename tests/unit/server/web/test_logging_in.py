"""Logging in: the password is checked without holding the database."""

from __future__ import annotations

import datetime as dt

import pytest
from robotether_server import passwords
from robotether_server.problems import LoginFailed, Throttled
from robotether_server.store import Database, logins, users
from robotether_server.store.audit import Source
from robotether_server.web.logging_in import log_in, log_out
from web_visitor import HASH, PASSWORD

HOUR = dt.timedelta(hours=1)
ANN = Source("ann", "192.0.2.1")


@pytest.fixture(autouse=True)
def _ann(database: Database) -> None:
    with database.transaction() as tx:
        users.add(tx, "ann", HASH, "user")


def test_right_password_makes_a_login(database: Database) -> None:
    """Which ends with the log-out."""
    text = log_in(database, ANN, PASSWORD, HOUR)
    with database.transaction() as tx:
        user = logins.find_user(tx, text)
    assert user is not None
    assert user.name == "ann"
    log_out(database, ANN, text)
    with database.transaction() as tx:
        assert logins.find_user(tx, text) is None


def test_disabled_user_looks_like_a_wrong_password(database: Database) -> None:
    """The same sentence for all three."""
    sentences = set()
    with database.transaction() as tx:
        users.add(tx, "gone", HASH, "user")
        users.set_disabled(tx, users.get(tx, "gone").id, disabled=True)
    for name, password in (("ann", "wrong"), ("nobody", PASSWORD), ("gone", PASSWORD)):
        with pytest.raises(LoginFailed) as failed:
            log_in(database, Source(name, "192.0.2.1"), password, HOUR)
        sentences.add(failed.value.detail)
    assert len(sentences) == 1


def test_throttled_try_costs_no_hash(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    """An attacker cannot keep the processor busy."""
    for _ in range(5):
        with pytest.raises(LoginFailed):
            log_in(database, ANN, "wrong", HOUR)
    monkeypatch.setattr(passwords, "matches", None)
    with pytest.raises(Throttled):
        log_in(database, ANN, PASSWORD, HOUR)

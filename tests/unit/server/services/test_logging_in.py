"""Log-ins, and when the next attempt is accepted."""

import datetime as dt
from contextlib import contextmanager

import pytest
from robotether_server import passwords
from robotether_server.db import Database, audit, users
from robotether_server.db.audit import Source
from robotether_server.problems import LoginFailedError, ThrottledError
from robotether_server.services.logging_in import (
    PER_NETWORK,
    PER_USER,
    PER_USER_AND_NETWORK,
    WINDOW,
    Failures,
    confirm,
    free_at,
    log_in,
)
from web_visitor import HASH, PASSWORD

HOUR = dt.timedelta(hours=1)
ANN = Source("ann", "192.0.2.1")


@pytest.fixture(autouse=True)
def _ann(database):
    with database.transaction() as tx:
        users.add(tx, "ann", HASH, "user")


def test_disabled_user_looks_like_a_wrong_password(database):
    sentences = set()
    with database.transaction() as tx:
        users.add(tx, "gone", HASH, "user")
        users.set_disabled(tx, users.get(tx, "gone").id, disabled=True)
    for name, password in (("ann", "wrong"), ("nobody", PASSWORD), ("gone", PASSWORD)):
        with pytest.raises(LoginFailedError) as failed:
            log_in(database, Source(name, "192.0.2.1"), password, HOUR)
        sentences.add(failed.value.detail)
    assert len(sentences) == 1


@pytest.mark.parametrize("change", ["password", "disabled"])
def test_what_an_admin_changes_during_the_check_counts(database, monkeypatch, change):
    """Whoever has the old password gets no login that outlives it."""

    def matches(_password, _hash):
        with database.transaction() as tx:
            ann = users.get(tx, "ann").id
            if change == "password":
                users.set_password(tx, ann, "another hash")
            else:
                users.set_disabled(tx, ann, disabled=True)
        return True

    monkeypatch.setattr(passwords, "matches", matches)
    with pytest.raises(LoginFailedError):
        log_in(database, ANN, PASSWORD, HOUR)
    with database.transaction() as tx:
        assert tx.row("SELECT 1 FROM logins") is None


def test_throttled_try_costs_no_hash(database, monkeypatch):
    """An attacker cannot keep the processor busy."""
    for _ in range(5):
        with pytest.raises(LoginFailedError):
            log_in(database, ANN, "wrong", HOUR)
    monkeypatch.setattr(passwords, "matches", None)
    with pytest.raises(ThrottledError):
        log_in(database, ANN, PASSWORD, HOUR)


class OlderDatabase(Database):
    """Its clock is an hour behind that of this machine."""

    def __init__(self, database):
        vars(self).update(vars(database))

    @contextmanager
    def transaction(self):
        with super().transaction() as tx:
            tx.change("SET timestamp = UNIX_TIMESTAMP() - 3600")
            yield tx


def test_logins_last_and_failures_count_by_the_clock_that_they_were_written_by(database):
    older = OlderDatabase(database)
    log_in(older, ANN, PASSWORD, HOUR)
    with database.transaction() as tx:
        row = tx.row("SELECT expires_at - INTERVAL 1 HOUR <= created_at AS has_ended FROM logins")
    assert row == {"has_ended": 1}
    fail(older, "ann", "192.0.2.1", PER_USER_AND_NETWORK)
    assert not is_heard(older, "ann", "192.0.2.1")


class AfterCommits(Database):
    """Calls `then` after each commit, before anything else happens."""

    def __init__(self, database, then):
        # The same account, and the same connections.
        vars(self).update(vars(database))
        self._then = then

    @contextmanager
    def transaction(self):
        with super().transaction() as tx:
            yield tx
        self._then()


def test_guess_counts_once_when_its_outcome_has_just_come_into_the_log(database):
    """The last try that is left is somebody's who comes in that moment."""
    fail(database, "ann", "192.0.2.1", PER_USER_AND_NETWORK - 2)
    outcomes = []

    def come_after_the_failure():
        if failures(database) == PER_USER_AND_NETWORK - 1:
            outcomes.append(is_heard(database, "ann", "192.0.2.1"))

    with pytest.raises(LoginFailedError):
        log_in(AfterCommits(database, come_after_the_failure), ANN, "wrong", HOUR)
    assert outcomes == [True]


def test_confirming_makes_no_login(database):
    confirm(database, ANN, PASSWORD)
    with database.transaction() as tx:
        assert tx.row("SELECT 1 FROM logins") is None
    for _ in range(5):
        with pytest.raises(LoginFailedError, match="current password"):
            confirm(database, ANN, "wrong")
    with pytest.raises(ThrottledError):
        log_in(database, ANN, PASSWORD, HOUR)


def fail(database, name, address, times=1):
    """Failures as the log has them; hashing so many passwords would take long."""
    with database.transaction() as tx:
        for _ in range(times):
            audit.record(tx, Source(name, address), "login_failed")


def failures(database):
    with database.transaction() as tx:
        return len(audit.recent_of(tx, "login_failed", "ann", START))


def is_heard(database, name, address):
    try:
        log_in(database, Source(name, address), PASSWORD, HOUR)
    except LoginFailedError:
        pass
    except ThrottledError:
        return False
    return True


def test_addresses_of_one_ipv6_network_count_together(database):
    """Who has a whole /64 gets no more tries than who has one address."""
    for host in range(5):
        fail(database, "ann", f"2001:db8::{host:x}")
    assert not is_heard(database, "ann", "2001:db8::99")
    assert is_heard(database, "ann", "2001:db8:0:1::1")


def test_success_ends_what_the_pair_failed_before(database):
    """A user who mistypes now and then is not added up; the network's own count goes on."""
    fail(database, "ann", "192.0.2.1", 4)
    assert is_heard(database, "ann", "192.0.2.1")
    fail(database, "ann", "192.0.2.1", 4)
    assert is_heard(database, "ann", "192.0.2.1")
    fail(database, "bob", "192.0.2.1", 22)
    assert not is_heard(database, "ann", "192.0.2.1")


def test_success_of_one_does_not_clear_another(database):
    """An attacker's own account is no way to more tries with somebody else's."""
    with database.transaction() as tx:
        users.add(tx, "mallory", HASH, "user")
    fail(database, "ann", "192.0.2.1", 5)
    assert is_heard(database, "mallory", "192.0.2.1")
    assert not is_heard(database, "ann", "192.0.2.1")


def test_many_addresses_against_one_user_lock_nobody_out_at_home(database):
    """New addresses wait, for that user alone; where the user has logged in before all goes on."""
    assert is_heard(database, "ann", "192.0.2.1")
    for host in range(50):
        fail(database, "ann", f"198.51.100.{host}")
    assert not is_heard(database, "ann", "203.0.113.5")
    assert is_heard(database, "nobody", "203.0.113.5")
    assert is_heard(database, "ann", "192.0.2.1")


def test_networks_of_a_removed_user_are_new_to_the_next_of_that_name(database):
    assert is_heard(database, "ann", "192.0.2.1")
    with database.transaction() as tx:
        users.remove(tx, users.get(tx, "ann").id)
        users.add(tx, "ann", HASH, "user")
    fail(database, "ann", "198.51.100.1", PER_USER)
    assert not is_heard(database, "ann", "192.0.2.1")


START = dt.datetime(2026, 1, 1, tzinfo=dt.UTC)


def timestamps(count):
    return [START + dt.timedelta(seconds=at) for at in range(count)]


@pytest.mark.parametrize(
    ("of_pair", "of_network", "of_user", "wait_s"),
    [
        (PER_USER_AND_NETWORK - 1, PER_NETWORK - 1, PER_USER - 1, None),
        # With two failures too many the third is the one whose end leaves one fewer than the limit.
        (PER_USER_AND_NETWORK + 2, 0, 0, 2),
        (0, PER_NETWORK + 2, 0, 2),
        (0, 0, PER_USER + 2, 2),
        (0, PER_NETWORK, PER_USER + 7, 7),
    ],
)
def test_a_try_waits_until_no_limit_holds(of_pair, of_network, of_user, wait_s):
    """The latest of their ends counts."""
    free = free_at(Failures(timestamps(of_pair), timestamps(of_network), timestamps(of_user)))
    assert free == (None if wait_s is None else START + dt.timedelta(seconds=wait_s) + WINDOW)

"""The audit log in the real database."""

import datetime as dt
from ipaddress import ip_network

import pytest
from robotether_server.db import audit, users
from robotether_server.db.audit import Source, network_of


def test_event_is_written_with_who_where_and_what(database):
    """A name that somebody claimed is cut to fit, whatever it is."""
    with database.transaction() as tx:
        audit.record(tx, Source("é" * 70, "192.0.2.1"), "login_failed", "sim1", a="ü")
        row = tx.row("SELECT actor, kind, robot, address, details FROM audit_events")
    written = ("é" * 63, "login_failed", "sim1", "192.0.2.1", '{"a": "\\u00fc"}')
    assert tuple(row.values()) == written


def record(tx, kind, actor, address):
    audit.record(tx, Source(actor, address), kind)


def test_recent_events_are_of_an_actor_or_of_a_network(database):
    """The oldest comes first; an address without a place counts for none."""
    now, minute = dt.datetime.now(dt.UTC), dt.timedelta(minutes=1)
    network, kinds = network_of("192.0.2.1"), ("login_failed", "login")
    with database.transaction() as tx:
        for kind, actor, address in (
            ("login_failed", "ann", "192.0.2.1"),
            ("login_failed", "bob", "192.0.2.1"),
            ("login", "ann", "192.0.2.1"),
            ("logout", "ann", "192.0.2.1"),
            ("login_failed", "ann", "2001:db8::1"),
            ("login_failed", "ann", None),
        ):
            record(tx, kind, actor, address)
        recent = audit.recent_from(tx, kinds, network, now - minute)
        found = [(item.kind, item.actor) for item in recent]
        assert found == [("login_failed", "ann"), ("login_failed", "bob"), ("login", "ann")]
        assert recent[0].at <= recent[1].at
        assert len(audit.recent_of(tx, "login_failed", "ann", now - minute)) == 3
        assert audit.recent_from(tx, kinds, network, now + minute) == []
        assert audit.recent_of(tx, "login_failed", "ann", now + minute) == []


@pytest.mark.parametrize(
    ("address", "other", "same"),
    [
        ("2001:db8::1", "2001:db8:0:0:ffff:ffff:ffff:ffff", True),
        ("2001:db8::1", "2001:db8:0:1::1", False),
        ("2001:db8::1", "32.1.13.184", False),
        ("::ffff:192.0.2.1", "::ffff:192.0.2.2", False),
    ],
)
def test_network_of_ipv6_is_found_in_every_spelling(database, address, other, same):
    since = dt.datetime.now(dt.UTC) - dt.timedelta(minutes=1)
    with database.transaction() as tx:
        users.add(tx, "ann", "x", "user")
        record(tx, "login", "ann", other)
        found = audit.recent_from(tx, ("login",), network_of(address), since)
        assert (found != []) is same
        assert audit.has_come_from(tx, "login", "ann", network_of(address)) is same
        assert not audit.has_come_from(tx, "login", "bob", network_of(other))


@pytest.mark.parametrize(
    ("address", "network"),
    [
        ("192.0.2.1", "192.0.2.1/32"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("2001:db8:1:2::", "2001:db8:1:2::/64"),
        ("::ffff:192.0.2.1", "::ffff:192.0.2.1/128"),
        ("", "::/128"),
        ("rubbish", "::/128"),
    ],
)
def test_one_owner_has_one_network(address, network):
    assert network_of(address) == ip_network(network)

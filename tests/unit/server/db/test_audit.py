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
    now, minute = dt.datetime.now(dt.UTC), dt.timedelta(minutes=1)
    with database.transaction() as tx:
        users.add(tx, "ann", "x", "user")
        record(tx, "login", "ann", other)
        found = audit.recent_from(tx, ("login",), network_of(address), now - minute)
        assert (found != []) is same
        assert audit.recent_from(tx, ("login",), network_of(other), now + minute) == []
        assert audit.recent_of(tx, "login", "ann", now + minute) == []
        assert audit.has_come_from(tx, "login", "ann", network_of(address)) is same
        assert not audit.has_come_from(tx, "login", "bob", network_of(other))


@pytest.mark.parametrize(
    ("address", "network"),
    [
        ("192.0.2.1", "192.0.2.1/32"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("::ffff:192.0.2.1", "::ffff:192.0.2.1/128"),
        ("", "::/128"),
        ("rubbish", "::/128"),
    ],
)
def test_one_owner_has_one_network(address, network):
    assert network_of(address) == ip_network(network)

"""The audit log in the real database."""

from ipaddress import ip_network

import pytest
from robotether_server.db import audit
from robotether_server.db.audit import Source, network_of


def test_event_is_written_with_who_where_and_what(database):
    """A name that somebody claimed is cut to fit, whatever it is."""
    with database.transaction() as tx:
        audit.record(tx, Source("é" * 70, "192.0.2.1"), "login_failed", "sim1", a="ü")
        row = tx.row("SELECT actor, kind, robot, address, details FROM audit_events")
    written = ("é" * 63, "login_failed", "sim1", "192.0.2.1", '{"a": "\\u00fc"}')
    assert tuple(row.values()) == written


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

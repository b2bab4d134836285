"""Whose an address is."""

from __future__ import annotations

from ipaddress import ip_network

import pytest
from robotether_server.networks import network_of


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
def test_one_owner_has_one_network(address: str, network: str) -> None:
    """An IPv4 address, in either spelling, or a /64; what is no address is nobody's."""
    assert network_of(address) == ip_network(network)

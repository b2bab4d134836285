"""What counts as one network of those who fail."""

from ipaddress import ip_network

import pytest
from robotether_server.db.audit import network_of


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

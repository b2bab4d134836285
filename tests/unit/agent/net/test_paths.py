"""Whether a connection still leaves this machine as a new one would."""

from __future__ import annotations

import socket
from dataclasses import dataclass

import pytest
from robotether_agent.net.paths import Path, path_of


@dataclass
class Connection:
    """A connection's two ends, as they are told."""

    here: tuple[str, int]
    there: tuple[str, int]
    family: int = socket.AF_INET

    def getsockname(self):
        return self.here

    def getpeername(self):
        return self.there


@pytest.mark.parametrize(("host", "path"), [("127.0.0.1", Path.SAME), ("127.0.0.2", Path.MOVED)])
def test_a_real_connection(host, path):
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        socket.create_connection(server.getsockname(), source_address=(host, 0)) as connection,
    ):
        assert path_of(connection) is path


def test_its_address_is_gone():
    """Nothing can come back to an address that this machine has not."""
    assert path_of(Connection(("192.0.2.1", 1), ("127.0.0.1", 2))) is Path.GONE


def test_no_route():
    """A machine without a way out has no other one either; silence will tell."""
    assert path_of(Connection(("127.0.0.1", 1), ("255.255.255.255", 2))) is Path.SAME


def test_a_connection_that_has_ended():
    with socket.socket() as never_connected:
        assert path_of(never_connected) is Path.SAME

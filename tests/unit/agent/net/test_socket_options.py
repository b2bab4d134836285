"""What the kernel is told about a connection, and what it tells."""

from __future__ import annotations

import socket

import pytest
from robotether_agent.net import socket_options
from robotether_agent.net.socket_options import is_established, is_stuck, prepare, prepare_for_video


@pytest.fixture
def connection():
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        socket.create_connection(server.getsockname()) as made,
    ):
        yield made


def option(connection: socket.socket, number: int) -> int:
    return connection.getsockopt(socket.IPPROTO_TCP, number)


def test_a_dead_path_is_given_up_in_seconds(connection):
    """And small messages wait for nothing."""
    prepare(connection)
    assert option(connection, socket.TCP_NODELAY)
    assert option(connection, socket_options.TCP_USER_TIMEOUT) == socket_options.USER_TIMEOUT_MS


def test_video_keeps_little_unsent(connection):
    prepare(connection)
    before = option(connection, socket_options.TCP_NOTSENT_LOWAT)
    prepare_for_video(connection)
    assert before != option(connection, socket_options.TCP_NOTSENT_LOWAT) == 16 * 1024


def test_what_is_not_allowed_is_left_out(connection):
    """A kernel without BBR serves as well."""
    socket_options._set(connection, socket_options.TCP_CONGESTION, b"no such thing")
    socket_options._set(connection, 9999, 1)


def test_a_live_path_is_not_stuck(connection):
    """What the other side acknowledges is on its way; no TCP connection cannot be stuck."""
    connection.send(b"hello")
    assert not is_stuck(connection)
    assert is_established(connection)
    connection.close()
    assert not is_stuck(connection)
    assert not is_established(connection)

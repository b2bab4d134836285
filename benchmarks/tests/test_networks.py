"""The server's slow line carries what it says, for both ends together, and leaves nothing behind."""

from __future__ import annotations

import os
import socket
import subprocess
import threading
import time
from collections.abc import Iterator

import pytest
from namespaces import Namespace
from paper.networks import server_line

pytestmark = pytest.mark.skipif(os.geteuid() != 0, reason="an emulated line needs root")

MACHINE = "198.51.100.1"
SENT_BYTES = 300_000


@pytest.fixture
def machine() -> Iterator[None]:
    """An address of this machine that nothing else uses, of those for documentation."""
    address = [f"{MACHINE}/32", "dev", "lo"]
    # A run that was killed may have left it.
    subprocess.run(["ip", "address", "replace", *address], check=True)
    yield
    subprocess.run(["ip", "address", "del", *address], check=True)


def upload(listener: socket.socket, inside: Namespace) -> None:
    """Send SENT_BYTES from there, until they have all come."""
    with inside.entered():
        client = socket.socket()
    with client:
        client.settimeout(20)
        client.connect(listener.getsockname())
        server, _ = listener.accept()
        with server:
            sender = threading.Thread(target=client.sendall, args=(bytes(SENT_BYTES),))
            sender.start()
            left = SENT_BYTES
            while left:
                left -= len(server.recv(1 << 16))
            sender.join()


@pytest.mark.usefixtures("machine")
def test_both_ends_share_the_line() -> None:
    with server_line(4, MACHINE) as line, socket.create_server((MACHINE, 0)) as one:
        with socket.create_server((MACHINE, 0)) as other:
            started = time.monotonic()
            ends = ((one, line.operators.inside), (other, line.robots.inside))
            threads = [threading.Thread(target=upload, args=pair) for pair in ends]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join(30)
            took_s = time.monotonic() - started
        counts = line.counts()
    assert 2 * SENT_BYTES < counts["to_server_bytes"] < 2.4 * SENT_BYTES
    assert counts["from_server_bytes"] < SENT_BYTES / 5
    needed_s = 2 * SENT_BYTES * 8 / 4e6
    assert took_s > 0.9 * needed_s

"""What the relay's event loop mends of uvloop."""

import asyncio
import socket
import struct

import pytest
import uvloop
from local_network import insecure_tls
from relay_server import run_python
from robotether_server.relay.http.event_loop import EventLoop

# Closing resets the connection.
RESETS = struct.pack("ii", 1, 0)


async def _file_descriptor_after_reset():
    """Have TLS begin on a connection that the other end has reset; return what the socket takes for its own."""
    loop = asyncio.get_running_loop()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        ours = socket.create_connection(listener.getsockname())
        theirs, _ = listener.accept()
        theirs.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESETS)
        theirs.close()
        ours.setblocking(False)
        with pytest.raises(ConnectionResetError):
            await loop.create_connection(
                asyncio.Protocol, sock=ours, ssl=insecure_tls(), server_hostname="b"
            )
        # uvloop closes it in its next turn.
        await asyncio.sleep(0.05)
        return ours.detach()


def test_a_connection_that_failed_leaves_no_file_descriptor_to_close_again():
    """By then the descriptor may be another connection's."""
    assert uvloop.run(_file_descriptor_after_reset(), loop_factory=EventLoop) == -1


def test_a_loop_that_hangs_ends_the_process():
    """It says what it was at, so that Docker starts it again and somebody can mend it."""
    script = (
        "import asyncio, time; from robotether_server.relay.http.event_loop import watched\n"
        "async def hang():\n  await asyncio.sleep(0)\n  time.sleep(60)\n"
        "asyncio.run(watched(hang(), 0.5))"
    )
    done = run_python("-c", script)
    assert done.returncode == 1
    assert "in hang" in done.stderr

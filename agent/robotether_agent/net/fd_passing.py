"""Passes an open connection to OpenSSH's client, which would otherwise make its own.

Used by the tunnel and the doctor. The connection waits in a Unix socket that is also the client's stderr.
fd_passing_helper, which the client runs as its ProxyCommand, finds it there. So no name in a file system and no other
program is needed.
"""

from __future__ import annotations

import shlex
import socket
import sys
from array import array
from pathlib import Path

HELPER = Path(__file__).with_name("fd_passing_helper.py")


def proxy_options() -> list[str]:
    """Return the options with which OpenSSH's client takes its connection from fd_passing_helper."""
    # -I -S: nothing from this user's or this machine's Python comes in between, and it starts in half the time.
    words = [sys.executable, "-I", "-S", str(HELPER)]
    # OpenSSH expands % in the command, and gives it to a shell.
    command = " ".join(map(shlex.quote, words)).replace("%", "%%")
    return [f"ProxyCommand={command}", "ProxyUseFdpass=yes"]


def stderr_with(connection: socket.socket) -> tuple[socket.socket, socket.socket]:
    """Return our end and the client's end of a stderr in which `connection` waits for fd_passing_helper."""
    ours, clients = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        descriptor = array("i", [connection.fileno()])
        ours.sendmsg([b"\0"], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, descriptor)])
        ours.setblocking(False)
    except OSError:
        ours.close()
        clients.close()
        raise
    return ours, clients

"""What every test that talks to this machine itself needs: a free port, and TLS with a self-signed certificate."""

from __future__ import annotations

import socket
import ssl


def free_port() -> int:
    """A TCP port that was free on all of this machine's addresses a moment ago."""
    with socket.socket() as probe:
        probe.bind(("", 0))
        return int(probe.getsockname()[1])


def insecure_tls() -> ssl.SSLContext:
    """A TLS context that encrypts and accepts any certificate."""
    context = ssl.create_default_context()
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    return context

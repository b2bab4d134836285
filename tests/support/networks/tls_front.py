"""Something that shows a certificate on a free port, as nginx does in the stack."""

from __future__ import annotations

import socket
import ssl
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from dated_certificate import make_certificate


@dataclass
class TlsFront:
    certificate: Path
    endpoint: tuple[str, int]
    handshakes: int = 0


def openssl(*arguments: str, stdin: bytes = b"") -> bytes:
    done = subprocess.run(["openssl", *arguments], input=stdin, check=True, capture_output=True)
    return done.stdout


def make_pair(certificate: Path, key: Path, name: str, *options: str) -> None:
    """Make a key, and a certificate that it signs itself."""
    openssl(
        *("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-noenc"),
        *("-days", "2", "-subj", f"/CN={name}", *options),
        *("-keyout", str(key), "-out", str(certificate)),
    )


@contextmanager
def running(folder: Path) -> Iterator[TlsFront]:
    certificate = make_certificate(folder)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        front = TlsFront(certificate, listener.getsockname())
        server = threading.Thread(target=_serve, args=(listener, context, front))
        server.start()
        try:
            yield front
        finally:
            # Closing alone does not wake a thread that waits in accept.
            listener.shutdown(socket.SHUT_RDWR)
            server.join(5)


def _serve(listener: socket.socket, context: ssl.SSLContext, front: TlsFront) -> None:
    while True:
        try:
            plain, _ = listener.accept()
        except OSError:
            return
        front.handshakes += 1
        # A client that does not accept the certificate ends the handshake.
        with plain, suppress(OSError), context.wrap_socket(plain, server_side=True) as tls:
            tls.recv(1)

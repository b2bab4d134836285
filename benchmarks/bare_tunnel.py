"""A bare `ssh -R` as in the paper, to compare with: OpenSSH at both ends, nothing of ours in between."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from local_network import free_port
from namespaces import Namespace
from openssh_server import OpenSshServer, listens, make_key, wait_until

LOCALHOST = "127.0.0.1"
OPTIONS = (
    "BatchMode=yes",
    "StrictHostKeyChecking=no",
    "UserKnownHostsFile=/dev/null",
    "LogLevel=ERROR",
    "ExitOnForwardFailure=yes",
)


@contextmanager
def bare_forward(
    sshd: OpenSshServer,
    robot_id: int,
    forwards: Mapping[int, str],
    *,
    host: str = LOCALHOST,
    inside: Namespace | None = None,
    bind: str = LOCALHOST,
) -> Iterator[None]:
    """A connection to sshd at `host`, with a key of its own, from this network or a namespace; all forwards stand.

    Ports at `bind` lead to an ADDRESS:PORT of the client's side each.
    """
    with tempfile.TemporaryDirectory(prefix="rt-bare-") as name:
        key = Path(name) / "key"
        sshd.authorize_too(make_key(key), tuple(forwards), robot_id)
        command = ["ssh", "-F", "none", "-N", "-i", str(key), "-p", str(sshd.port)]
        command += [word for option in OPTIONS for word in ("-o", option)]
        command += [word for port, to in forwards.items() for word in ("-R", f"{bind}:{port}:{to}")]
        command.append(f"{sshd.user}@{host}")
        log = Path(name) / "ssh.log"
        # Its last word, that the server has gone, is for nobody.
        with (
            log.open("wb") as words,
            subprocess.Popen(
                inside.command(*command) if inside else command,
                stdin=subprocess.DEVNULL,
                stderr=words,
            ) as client,
        ):
            try:
                wait_until(
                    lambda: all(map(listens, forwards)),
                    lambda: f"the bare forward stands; {log.read_text()}\nsshd: {sshd.log_text()}",
                )
                yield
            finally:
                client.terminate()


@contextmanager
def bare_tunnel(to: str, bind: str = LOCALHOST, **where: Any) -> Iterator[int]:
    """A port at `bind` that leads through an sshd on this machine to ADDRESS:PORT of its client's side."""
    # No session is opened, so that the relay behind sshd's session command is never asked.
    sshd, own = OpenSshServer(relay_port=0, address=bind), free_port()
    try:
        sshd.start()
        with bare_forward(sshd, 1, {own: to}, bind=bind, **where):
            yield own
    finally:
        sshd.close()

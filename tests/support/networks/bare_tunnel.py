"""A bare `ssh -R` as in the paper, to compare with: OpenSSH on both ends, nothing of ours in between.

Used by experiments; client and server run on this machine and end with the `with` block.
"""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path
from types import TracebackType
from typing import Self

from local_network import free_port
from openssh_server import OpenSshServer, listens, wait_until


class BareTunnel:
    """`port` of 127.0.0.1 leads through sshd and ssh to HOST:PORT of the service."""

    def __init__(self, host: str, port: int) -> None:
        self.port = free_port()
        self._target = f"{host}:{port}"
        # No session is opened, so that the relay behind sshd's session command is never asked.
        self._server = OpenSshServer(relay_port=0)
        self._client: subprocess.Popen[bytes] | None = None
        self._folder = tempfile.TemporaryDirectory(prefix="rt-bare-")

    def __enter__(self) -> Self:
        key = Path(self._folder.name) / "key"
        subprocess.run(
            ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(key)],
            check=True,
            stdin=subprocess.DEVNULL,
        )
        self._server.authorize(key.with_suffix(".pub").read_text().strip(), (self.port,))
        self._server.start()
        self._client = subprocess.Popen(
            [
                "ssh", "-F", "none", "-N", "-i", str(key), "-p", str(self._server.port),
                "-o", "StrictHostKeyChecking=no", "-o", "UserKnownHostsFile=/dev/null", "-o", "LogLevel=ERROR",
                "-o", "ExitOnForwardFailure=yes",
                "-R", f"127.0.0.1:{self.port}:{self._target}", f"{self._server.user}@127.0.0.1",
            ],
            stdin=subprocess.DEVNULL,
        )  # fmt: skip
        wait_until(lambda: listens(self.port), lambda: f"ssh -R; sshd: {self._server.log_text()}")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._client is not None:
            self._client.terminate()
            self._client.wait(10)
        self._server.close()
        self._folder.cleanup()

"""A robot's real key that signs as its agent does, for tests of key rotation."""

from __future__ import annotations

import subprocess
from pathlib import Path

from robotether_server import identity
from robotether_server.identity import PublicKey


class RobotSigner:
    """An ed25519 key pair in a folder of its own."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / "key"
        command = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", "robot", "-f"]
        subprocess.run([*command, str(self._file)], check=True)
        self.line = self._file.with_suffix(".pub").read_text().strip()

    @property
    def key(self) -> PublicKey:
        """The public half."""
        return identity.parse_robots_key(self.line)

    def sign(self, namespace: str, message: str) -> str:
        """The armoured signature over a message."""
        command = ["ssh-keygen", "-q", "-Y", "sign", "-f", str(self._file), "-n", namespace]
        done = subprocess.run(command, input=message, check=True, capture_output=True, text=True)
        return done.stdout

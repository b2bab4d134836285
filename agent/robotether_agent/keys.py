"""Makes the robot's own key once, with ssh-keygen, and finds it again.

Called by the enroller at the start. The private half never leaves the state directory.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import logging
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path

from robotether_agent.files import read_text
from robotether_agent.problems import KeyUnusable, SshMissing, StateUnusable
from robotether_agent.tasks import within

KEYGEN_TIMEOUT_S = 30.0
NAME = "id_ed25519"
# The type, in words and again inside the base64, and the 36 bytes of length and point.
PUBLIC = re.compile(r"ssh-ed25519 AAAAC3NzaC1lZDI1NTE5[A-Za-z0-9+/]{48}(?![A-Za-z0-9+/=])")

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class KeyPair:
    """The private key's file and the public key as one line `ssh-ed25519 AAAA...`."""

    path: Path
    public: str

    @property
    def fingerprint(self) -> str:
        """The public key's SHA-256 as `ssh-keygen -l` prints it."""
        digest = hashlib.sha256(base64.b64decode(self.public.split()[1])).digest()
        return f"SHA256:{base64.b64encode(digest).decode().rstrip('=')}"


async def ensure_key(state_dir: Path) -> KeyPair:
    """Return the key in `state_dir`, made now if there is none."""
    path = state_dir / NAME
    if read_text(path) is None:
        await _make(path)
        log.info("made the robot's key %s", path)
    _protect(path)
    public = read_text(path.with_suffix(".pub")) or await _keygen("-y", "-f", str(path))
    found = PUBLIC.match(public)
    if found is None:
        raise KeyUnusable(
            f"cannot use the key {path}: its public half is not ssh-ed25519",
            advice=f"remove {path} and {path}.pub; the robot then joins with a new key",
        )
    return KeyPair(path, found.group())


async def _make(path: Path) -> None:
    try:
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=".key.") as place:
            made = Path(place) / NAME
            await _keygen("-q", "-t", "ed25519", "-N", "", "-C", "robotether", "-f", str(made))
            # The private half comes last: a power cut leaves either no key or a whole pair.
            made.with_suffix(".pub").replace(path.with_suffix(".pub"))
            made.replace(path)
    except OSError as error:
        raise StateUnusable(
            f"cannot make the robot's key in {path.parent}: {error.strerror}",
            advice="let the agent's user write there, or set state_dir to a place that it may write",
        ) from error


def _protect(path: Path) -> None:
    try:
        if path.stat().st_mode & 0o077:
            path.chmod(0o600)
    except OSError as error:
        raise KeyUnusable(
            f"cannot protect the key {path}, which others may read: {error.strerror}",
            advice=f"give it to the agent's user with mode 600: chmod 600 {path}",
        ) from error


async def _keygen(*arguments: str) -> str:
    try:
        process = await asyncio.create_subprocess_exec(
            "ssh-keygen",
            *arguments,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )
    except FileNotFoundError as error:
        raise SshMissing("cannot make the robot's key: there is no ssh-keygen") from error
    try:
        out, err = await within(KEYGEN_TIMEOUT_S, process.communicate())
    except asyncio.TimeoutError as error:
        raise KeyUnusable(f"cannot run ssh-keygen: no end after {KEYGEN_TIMEOUT_S:g} s") from error
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    if process.returncode:
        reason = err.decode(errors="replace").strip()
        raise KeyUnusable(f"cannot run ssh-keygen on {arguments[-1]}: {reason}")
    return out.decode(errors="replace")

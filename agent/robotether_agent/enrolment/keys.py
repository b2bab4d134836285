"""The robot's own key, made once with ssh-keygen, and the server's host keys, which the first join pins.

Called by the enroller. The private half never leaves the state directory. At each step of a change the
key that the server knows is in one of two files, and both are shown to the server: a robot that loses its
power then still gets in. Nothing but the first join ever changes the pin, which OpenSSH's client reads. Its lines
are under one alias, so that it holds for every address and port that the server may be reached at.
"""

from __future__ import annotations

import asyncio
import base64
import binascii
import hashlib
import logging
import re
import tempfile
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from robotether_agent.fields import FieldError, printable
from robotether_agent.files import disk_problem, read_text, sync, write_atomic
from robotether_agent.problems import (
    KeyUnusableError,
    ServerKeyChangedError,
    SshMissingError,
    StateUnusableError,
)
from robotether_agent.tasks import within

KEYGEN_TIMEOUT_S = 30.0
NAME = "id_ed25519"
# The key that takes the place of the other one as soon as the server knows it.
NEXT = "id_ed25519.next"
# The type, in words and again inside the base64, and the 36 bytes of length and point.
PUBLIC = re.compile(r"ssh-ed25519 AAAAC3NzaC1lZDI1NTE5[A-Za-z0-9+/]{48}(?![A-Za-z0-9+/=])")
ALIAS = "robotether-server"
KNOWN_HOSTS = "known_hosts"
KEY_TYPE = re.compile(r"ssh-ed25519|ssh-rsa|ecdsa-sha2-nistp(256|384|521)")

HOST_KEY_ADVICE = (
    "SOMEBODY MAY BE POSING AS THE SERVER, so the agent stops; ask the server's administrator, and only "
    "if its keys were changed on purpose: remove {known_hosts} and start the agent again"
)

log = logging.getLogger(__name__)


def fingerprint_of(blob: str) -> str:
    """Return the SHA-256 of a public key, given in base64, as `ssh-keygen -l` prints it."""
    digest = hashlib.sha256(base64.b64decode(blob)).digest()
    return f"SHA256:{base64.b64encode(digest).decode().rstrip('=')}"


@dataclass(frozen=True)
class KeyPair:
    """The private key's file and the public key as one line `ssh-ed25519 AAAA...`."""

    path: Path
    public: str

    @property
    def fingerprint(self) -> str:
        """The public key's SHA-256 as `ssh-keygen -l` prints it."""
        return fingerprint_of(self.public.split()[1])


@dataclass(frozen=True)
class HostKey:
    """One public host key; `blob` is base64 as in known_hosts."""

    type: str
    blob: str

    @property
    def fingerprint(self) -> str:
        """As OpenSSH prints it: SHA256:..."""
        return fingerprint_of(self.blob)


async def ensure_key(state_dir: Path) -> KeyPair:
    """Return the key in `state_dir`, made now if there is none."""
    return await _ensure(state_dir / NAME, "the robot's key")


async def ensure_next_key(state_dir: Path) -> KeyPair:
    """Return the key that is to replace the other one, made now if there is none."""
    return await _ensure(state_dir / NEXT, "the robot's next key")


async def present_key(state_dir: Path) -> KeyPair | None:
    """Return the robot's key as it is, or None when there is none yet; changes nothing, not even its mode."""
    return await _read(state_dir / NAME)


def is_protected(key: Path) -> bool:
    """Return whether only the owner may read the file `key`, without which OpenSSH does not use it."""
    return not key.stat().st_mode & 0o077


async def next_key(state_dir: Path) -> KeyPair | None:
    """Return the key that is to replace the other one, if a change has begun."""
    try:
        return await _load(state_dir / NEXT)
    except KeyUnusableError as problem:
        # The key that is in use must not suffer from it; a rotation reports it loudly.
        log.debug("%s; leaving it out", problem)
        return None


async def promote(state_dir: Path) -> None:
    """Put the next key in the place of the other one; safe to do twice, and to be cut short anywhere."""
    key, coming = state_dir / NAME, state_dir / NEXT
    if not coming.exists():
        # Another process of this robot has done it.
        return
    try:
        # First, so that no public half is ever beside another key's private half.
        _public(key).unlink(missing_ok=True)
        coming.replace(key)
        _public(coming).replace(_public(key))
        await asyncio.to_thread(sync, state_dir)
    except FileNotFoundError:
        return
    except OSError as error:
        what = f"cannot put the robot's new key in the place of {key}, so both are kept"
        raise disk_problem(what, state_dir, error) from error


def discard_next(state_dir: Path) -> None:
    """Forget the next key, which the server does not want."""
    try:
        for path in (state_dir / NEXT, _public(state_dir / NEXT)):
            path.unlink(missing_ok=True)
    except OSError as error:
        what = f"cannot remove the robot's next key in {state_dir}, so the robot keeps its key"
        raise disk_problem(what, state_dir, error) from error


async def sign(key: KeyPair, namespace: str, text: str) -> str:
    """Return the signature that proves to the server that this robot has `key`, as one text."""
    words = ("-Y", "sign", "-n", namespace, "-f", str(key.path))
    return await _keygen(*words, stdin=text.encode())


def _public(path: Path) -> Path:
    return path.with_name(f"{path.name}.pub")


async def _ensure(path: Path, what: str) -> KeyPair:
    if read_text(path) is None:
        await _make(path, what)
    key = await _load(path)
    if key is None:
        raise KeyUnusableError(f"cannot use the key {path}: it went away")
    return key


async def _load(path: Path) -> KeyPair | None:
    _protect(path)
    return await _read(path)


async def _read(path: Path) -> KeyPair | None:
    if read_text(path) is None:
        return None
    public = read_text(_public(path)) or await _keygen("-y", "-f", str(path))
    match = PUBLIC.match(public)
    if match is None:
        raise KeyUnusableError(
            f"cannot use the key {path}: its public half is not ssh-ed25519",
            advice=f"remove {path} and {path}.pub; the robot then joins with a new key",
        )
    return KeyPair(path, match.group())


async def _make(path: Path, what: str) -> None:
    try:
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=".key.") as place:
            new_key = Path(place) / NAME
            await _keygen("-q", "-t", "ed25519", "-N", "", "-C", "robotether", "-f", str(new_key))
            # The server may soon know only this key, so a power cut must not lose it. In a thread: a memory card takes
            # seconds, and the guard stops a robot whose agent is silent for one.
            await asyncio.to_thread(sync, new_key)
            _put(new_key, path)
            await asyncio.to_thread(sync, path.parent)
            log.info("made %s %s", what, path)
    except FileExistsError:
        return
    except OSError as error:
        advice = "let the agent's user write there, or set state_dir to a place that it may write"
        raise disk_problem(
            f"cannot make {what} in {path.parent}", path.parent, error, advice=advice
        ) from error


def _put(new_key: Path, path: Path) -> None:
    _public(path).unlink(missing_ok=True)
    # A link, since it refuses to replace what another process of this robot has made meanwhile.
    path.hardlink_to(new_key)
    _public(new_key).replace(_public(path))


def _protect(path: Path) -> None:
    try:
        if not is_protected(path):
            path.chmod(0o600)
    except FileNotFoundError:
        return
    except OSError as error:
        raise KeyUnusableError(
            f"cannot protect the key {path}, which others may read: {error.strerror}",
            advice=f"give it to the agent's user with mode 600: chmod 600 {path}",
        ) from error


async def _keygen(*arguments: str, stdin: bytes = b"") -> str:
    try:
        process = await asyncio.create_subprocess_exec(
            "ssh-keygen",
            *arguments,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )
    except FileNotFoundError as error:
        raise SshMissingError("cannot make the robot's key: there is no ssh-keygen") from error
    except OSError as error:
        raise KeyUnusableError(f"cannot run ssh-keygen: {error.strerror}") from error
    try:
        out, err = await within(KEYGEN_TIMEOUT_S, process.communicate(stdin))
    except asyncio.TimeoutError as error:
        raise KeyUnusableError(
            f"cannot run ssh-keygen: no end after {KEYGEN_TIMEOUT_S:g} s"
        ) from error
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    if process.returncode:
        reason = err.decode(errors="replace").strip()
        raise KeyUnusableError(
            f"cannot run ssh-keygen on {arguments[-1]}: {reason}",
            advice="if this file is damaged, remove it: a robot without a key joins with a new one",
        )
    return out.decode(errors="replace")


def parse_host_key(text: str) -> HostKey:
    """Return the key in `text` ("ssh-ed25519 AAAA... comment"); raise FieldError."""
    excerpt = printable(text, 60)
    kind, _, rest = text.strip().partition(" ")
    text_of_blob = rest.partition(" ")[0]
    if not KEY_TYPE.fullmatch(kind):
        raise FieldError(f"field host_keys must hold SSH public keys, not {excerpt!r}")
    try:
        blob = base64.b64decode(text_of_blob, validate=True)
    except (ValueError, binascii.Error) as error:
        raise FieldError(f"field host_keys holds a broken key {excerpt!r}") from error
    name = kind.encode()
    if not blob.startswith(len(name).to_bytes(4, "big") + name):
        raise FieldError(f"field host_keys holds a key of another type than it says: {excerpt!r}")
    return HostKey(kind, text_of_blob)


def pinned_host_keys(path: Path) -> list[HostKey]:
    """Return the keys in the file `path`, none when there is no such file."""
    text = read_text(path)
    if text is None:
        return []
    lines = [line.partition(" ") for line in text.splitlines()]
    try:
        keys = [parse_host_key(key) for alias, _, key in lines if alias == ALIAS]
    except FieldError as error:
        raise _broken_pin(path, str(error)) from error
    if not keys:
        raise _broken_pin(path, "no key in it")
    return keys


def _broken_pin(path: Path, why: str) -> StateUnusableError:
    # Not the same as no file: pinning again by itself would make the pin worthless.
    return StateUnusableError(
        f"cannot use the pinned host keys in {path}: {why}", advice=f"remove {path}"
    )


def pin_host_keys(path: Path, keys: Collection[HostKey]) -> None:
    """Write `keys` as the only ones to trust."""
    write_atomic(path, "".join(f"{ALIAS} {key.type} {key.blob}\n" for key in keys), 0o644)


def check_host_keys(path: Path, before: Collection[HostKey], now: Collection[HostKey]) -> None:
    """Raise ServerKeyChangedError unless `now` agrees with `before` in every type of key that both have.

    A type that is new is not trusted either: the pin stays as the first join made it.
    """
    common = {key.type for key in before} & {key.type for key in now}
    changed = {key.type for key in set(before) ^ set(now)} & common
    if common and not changed:
        return
    new_fingerprints = ", ".join(sorted(key.fingerprint for key in now))
    old_fingerprints = ", ".join(sorted(key.fingerprint for key in before))
    raise ServerKeyChangedError(
        f"cannot trust the server: its SSH host keys are now {new_fingerprints}, "
        f"and at the first join were {old_fingerprints}",
        advice=HOST_KEY_ADVICE.format(known_hosts=path),
    )

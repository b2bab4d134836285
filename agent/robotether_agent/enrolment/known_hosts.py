"""Pins the server's SSH host keys: the first join sets them, nothing else ever changes them.

Written by the enroller, read by OpenSSH's client. All lines stand under one alias, so that the pin
holds for every address and port that the server may be reached at.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from robotether_agent.fields import FieldError, printable
from robotether_agent.files import read_text, write_atomic
from robotether_agent.problems import ServerKeyChanged, StateUnusable

ALIAS = "robotether-server"
FILE = "known_hosts"
KEY_TYPE = re.compile(r"ssh-ed25519|ssh-rsa|ecdsa-sha2-nistp(256|384|521)")


def fingerprint_of(blob: str) -> str:
    """Return the SHA-256 of a public key, given in base64, as `ssh-keygen -l` prints it."""
    digest = hashlib.sha256(base64.b64decode(blob)).digest()
    return f"SHA256:{base64.b64encode(digest).decode().rstrip('=')}"


@dataclass(frozen=True)
class HostKey:
    """One public host key; `blob` is base64 as in known_hosts."""

    type: str
    blob: str

    @property
    def fingerprint(self) -> str:
        """As OpenSSH prints it: SHA256:..."""
        return fingerprint_of(self.blob)


def parse_host_key(text: str) -> HostKey:
    """Return the key in `text` ("ssh-ed25519 AAAA... comment"); raise FieldError."""
    shown = printable(text, 60)
    kind, _, rest = text.strip().partition(" ")
    text_of_blob = rest.partition(" ")[0]
    if not KEY_TYPE.fullmatch(kind):
        raise FieldError(f"field host_keys must hold SSH public keys, not {shown!r}")
    try:
        blob = base64.b64decode(text_of_blob, validate=True)
    except (ValueError, binascii.Error) as error:
        raise FieldError(f"field host_keys holds a broken key {shown!r}") from error
    name = kind.encode()
    if not blob.startswith(len(name).to_bytes(4, "big") + name):
        raise FieldError(f"field host_keys holds a key of another type than it says: {shown!r}")
    return HostKey(kind, text_of_blob)


def pinned(path: Path) -> list[HostKey]:
    """Return the keys in the file `path`, none when there is no such file."""
    text = read_text(path)
    if text is None:
        return []
    lines = [line.partition(" ") for line in text.splitlines()]
    try:
        keys = [parse_host_key(key) for alias, _, key in lines if alias == ALIAS]
    except FieldError as error:
        raise _broken(path, str(error)) from error
    if not keys:
        raise _broken(path, "no key in it")
    return keys


def _broken(path: Path, why: str) -> StateUnusable:
    # Not the same as no file: pinning again by itself would make the pin worthless.
    return StateUnusable(
        f"cannot use the pinned host keys in {path}: {why}", advice=f"remove {path}"
    )


def pin(path: Path, keys: Collection[HostKey]) -> None:
    """Write `keys` as the only ones to trust."""
    write_atomic(path, "".join(f"{ALIAS} {key.type} {key.blob}\n" for key in keys), 0o644)


def check(path: Path, before: Collection[HostKey], now: Collection[HostKey]) -> None:
    """Raise ServerKeyChanged unless `now` agrees with `before` in every type of key that both have.

    A type that is new is not trusted either: the pin stays as the first join made it.
    """
    common = {key.type for key in before} & {key.type for key in now}
    changed = {key.type for key in set(before) ^ set(now)} & common
    if common and not changed:
        return
    shown = ", ".join(sorted(key.fingerprint for key in now))
    known = ", ".join(sorted(key.fingerprint for key in before))
    raise ServerKeyChanged(
        f"cannot trust the server: its SSH host keys are now {shown}, and at the first join were {known}",
        advice=advice(path),
    )


def advice(path: Path) -> str:
    """Return what a person can do about a changed host key."""
    return (
        "SOMEBODY MAY BE POSING AS THE SERVER, so the agent stops; ask the server's administrator, and only "
        f"if its keys were changed on purpose: remove {path} and start the agent again"
    )

"""Reads and extends OpenSSH's known_hosts files (sshd(8), "SSH_KNOWN_HOSTS FILE FORMAT").

Of paramiko's own reader, which knows neither aliases nor patterns nor markers, nothing is used.
"""

import base64
import binascii
import hashlib
import hmac
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from robotether_server.cli.fleet.problems import ConfigUnusable

HASHED = "|1|"
REVOKED = "@revoked"


@dataclass(frozen=True)
class KnownKey:
    """A host's public key: `ssh-ed25519` and its base64."""

    type: str
    encoded: str


@dataclass(frozen=True)
class Known:
    """The files' entries for one name."""

    trusted: frozenset[KnownKey]
    revoked: frozenset[KnownKey]


def find(files: Iterable[Path], name: str) -> Known:
    """Return the files' keys for a name; a missing file has none."""
    trusted, revoked = set(), set()
    for marker, hosts, key in (entry for path in files for entry in _entries(path)):
        if not names(hosts, name):
            continue
        # A @cert-authority's line is neither: certificates are not looked at here.
        if marker == REVOKED:
            revoked.add(key)
        elif not marker:
            trusted.add(key)
    return Known(frozenset(trusted), frozenset(revoked))


def add(path: Path, name: str, key: KnownKey) -> None:
    """Add a key to a file, which is made when it is missing; raise ConfigUnusable."""
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        path.touch(mode=0o600)
        whole = path.read_bytes()
        broken = bool(whole) and not whole.endswith(b"\n")
        with path.open("a", encoding="utf-8") as file:
            file.write("\n" * broken + f"{name} {key.type} {key.encoded}\n")
    except OSError as error:
        raise ConfigUnusable(f"cannot save the key of {name} in {path}: {error}") from error


def names(hosts: str, name: str) -> bool:
    """Tell whether the first field of a line matches this name: a hash, or patterns with commas between."""
    name = name.lower()
    if hosts.startswith(HASHED):
        return _hash_fits(hosts, name)
    patterns = hosts.lower().split(",")
    if any(_fits(pattern[1:], name) for pattern in patterns if pattern.startswith("!")):
        return False
    return any(_fits(pattern, name) for pattern in patterns)


def _entries(path: Path) -> Iterator[tuple[str, str, KnownKey]]:
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except FileNotFoundError:
        return
    except OSError as error:
        raise ConfigUnusable(f"cannot read the known host keys in {path}: {error}") from error
    for line in lines:
        fields = line.split()
        if not fields or fields[0].startswith("#"):
            continue
        marker = fields.pop(0) if fields[0].startswith("@") else ""
        match fields:
            case [hosts, kind, encoded, *_]:
                yield marker, hosts, KnownKey(kind, encoded)


def _fits(pattern: str, name: str) -> bool:
    """Compare with a pattern of `*` and `?`; brackets are literal, as in [host]:2222."""
    wanted = re.escape(pattern).replace(r"\*", ".*").replace(r"\?", ".")
    return re.fullmatch(wanted, name) is not None


def _hash_fits(hosts: str, name: str) -> bool:
    try:
        salt, wanted = (base64.b64decode(part) for part in hosts.removeprefix(HASHED).split("|", 1))
    except (ValueError, binascii.Error):
        return False
    return hmac.compare_digest(hmac.digest(salt, name.encode(), hashlib.sha1), wanted)

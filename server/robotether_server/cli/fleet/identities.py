"""The person's own keys, in OpenSSH's order: the agent's that the configuration names, its others, files.

The order matters, because a server hangs up after a few keys that it does not know.
"""

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import paramiko
from cryptography.exceptions import UnsupportedAlgorithm
from paramiko.auth_strategy import AuthStrategy, InMemoryPrivateKey

from robotether_server.cli.fleet.ssh_settings import Target

log = logging.getLogger(__name__)


class Identities(AuthStrategy):  # type: ignore[misc] # paramiko has no types
    """What one login tries. `locked`: files that need a passphrase."""

    def __init__(self, target: Target) -> None:
        super().__init__(ssh_config=None)
        self._target = target
        self.tried = 0
        self.locked: list[Path] = []
        # An agent's connection carries one request at a time, so each login has its own.
        self._agent = paramiko.Agent()

    def get_sources(self) -> Iterator[Any]:
        """Yield each key once."""
        held = list(self._agent.get_keys())
        named = {blob for path in self._target.identity_files for blob in _public_half(path)}
        chosen = [key for key in held if key.asbytes() in named]
        others = [] if self._target.identities_only else [key for key in held if key not in chosen]
        seen: set[bytes] = set()
        for key in (*chosen, *others, *self._from_files()):
            if key.asbytes() not in seen:
                seen.add(key.asbytes())
                self.tried += 1
                yield InMemoryPrivateKey(self._target.user, key)

    def close(self) -> None:
        """Leave ssh-agent."""
        self._agent.close()

    def _from_files(self) -> Iterator[Any]:
        for path in filter(Path.is_file, self._target.identity_files):
            if (key := self._from_file(path)) is not None:
                yield key

    def _from_file(self, path: Path) -> Any | None:
        try:
            return paramiko.PKey.from_path(path)
        except TypeError:  # cryptography's word for a key with a passphrase
            self.locked.append(path)
        except (OSError, ValueError, UnsupportedAlgorithm, paramiko.SSHException) as error:
            log.warning("cannot use key %s: %s", path, error)
        return None


def _public_half(path: Path) -> Iterator[bytes]:
    """Yield the public key beside a private one, by which ssh-agent knows it."""
    try:
        line = Path(f"{path}.pub").read_text(encoding="utf-8")
        yield paramiko.PublicBlob.from_string(line).key_blob
    except (OSError, ValueError):
        return

"""Decides whether a host is the one that it says: its key must be known, under the name that OpenSSH would look up.

paramiko asks this for every host, because its own list stays empty. An unknown key may be taken on a person's word
(`--accept-new`), a changed or revoked one never.
"""

import base64
from threading import Lock
from typing import Any

import paramiko

from robotether_server.cli.fleet import known_hosts
from robotether_server.cli.fleet.known_hosts import HostKey, Known
from robotether_server.cli.fleet.problems import ConfigUnusable, HostKeyChanged, HostKeyUnknown
from robotether_server.cli.fleet.ssh_settings import Target

# By the type of key that known_hosts has: what the server may prove it with.
ALGORITHMS = {
    "ssh-ed25519": ("ssh-ed25519",),
    "ecdsa-sha2-nistp256": ("ecdsa-sha2-nistp256",),
    "ecdsa-sha2-nistp384": ("ecdsa-sha2-nistp384",),
    "ecdsa-sha2-nistp521": ("ecdsa-sha2-nistp521",),
    "ssh-rsa": ("rsa-sha2-512", "rsa-sha2-256"),
}
WEAK = ("ssh-rsa", "ssh-dss")

_writing = Lock()


class HostKeyCheck(paramiko.MissingHostKeyPolicy):  # type: ignore[misc] # paramiko has no types
    """The check of one host."""

    def __init__(self, target: Target, *, accept_new: bool) -> None:
        self._target = target
        self._accept_new = accept_new
        self._known = known_hosts.find(target.known_hosts, target.known_as)

    def unwanted_algorithms(self) -> list[str]:
        """Return what the host must not prove itself with: of several keys it shall show the one that is known."""
        known = {key.type for key in self._known.trusted} & set(ALGORITHMS)
        wanted = known or set(ALGORITHMS)
        unwanted = [name for kind in ALGORITHMS if kind not in wanted for name in ALGORITHMS[kind]]
        return [*WEAK, *unwanted]

    def missing_host_key(self, _client: Any, _hostname: str, key: Any) -> None:
        """Let the connection go on, or raise HostKeyChanged or HostKeyUnknown."""
        shown = HostKey(key.get_name(), base64.b64encode(key.asbytes()).decode())
        target = self._target
        if judge(self._known, shown, target):
            return
        if not self._accept_new:
            raise HostKeyUnknown(
                f"cannot trust {target.name}: its host key {key.fingerprint} is not known as "
                f"{target.known_as}; compare it at a first `ssh`, or take it with --accept-new"
            )
        if not target.known_hosts:
            raise ConfigUnusable(f"cannot note the key of {target.name}: no UserKnownHostsFile")
        with _writing:
            known_hosts.add(target.known_hosts[0], target.known_as, shown)


def judge(known: Known, shown: HostKey, target: Target) -> bool:
    """Return whether the key is known (False: the host is new); raise HostKeyChanged when it is another one."""
    if shown in known.revoked:
        raise HostKeyChanged(f"cannot trust {target.name}: its host key is marked as revoked")
    if shown in known.trusted:
        return True
    if known.trusted:
        raise changed(target)
    return False


def changed(target: Target) -> HostKeyChanged:
    """Return the sentence for a host with another key than it had."""
    return HostKeyChanged(
        f"cannot trust {target.name}: it shows another host key than the one known as "
        f"{target.known_as}; if it was set up anew, forget the old one: "
        f"ssh-keygen -R '{target.known_as}'; if not, somebody stands in between"
    )

"""Keeps the answer to a join in the state directory, so that a robot connects without asking again.

Written and read by the enroller. The host keys stand beside it in known_hosts; remove that file and the
robot joins, and pins, anew.
"""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass
from pathlib import Path

from robotether_agent.enrolment import known_hosts
from robotether_agent.enrolment.known_hosts import HostKey
from robotether_agent.fields import (
    FieldError,
    JsonObject,
    get_match,
    get_object,
    get_ports,
    get_texts,
    parse_object,
)
from robotether_agent.files import read_text, write_atomic
from robotether_agent.setting_values import HOST, IPV6, MAC, ROBOT_NAME

FILE = "enrolment.json"
USER = re.compile(r"[a-z_][a-z0-9_-]{0,31}")
SERVER = re.compile(r"\S{1,300}")
ADDRESS = re.compile(f"(?:{HOST.pattern})|(?:{IPV6.pattern})")


@dataclass(frozen=True)
class SshAccess:
    """Where the tunnel goes; `host` None is the host that the join went to."""

    user: str
    host: str | None
    ports: tuple[int, ...]


@dataclass(frozen=True)
class Enrolment:
    """An active robot: its name, the MAC it joined with, and the server that it belongs to."""

    server: str
    robot: str
    mac: str
    ssh: SshAccess


def parse_ssh(obj: JsonObject) -> SshAccess:
    """Return the member `ssh` of a join answer or of the kept file."""
    # These become arguments of the SSH client, so they must not look like options.
    host = None if obj.get("host") is None else get_match(obj, "host", ADDRESS, "a host name")
    user = get_match(obj, "user", USER, "a user name")
    return SshAccess(user, host, get_ports(obj, "ports"))


def parse_host_keys(obj: JsonObject) -> list[HostKey]:
    """Return the list `host_keys` of a join answer."""
    return [known_hosts.parse_host_key(text) for text in get_texts(obj, "host_keys")]


class EnrolmentStore:
    """The two files in `state_dir` that make an enrolled robot."""

    def __init__(self, state_dir: Path) -> None:
        self.known_hosts = state_dir / known_hosts.FILE
        self._file = state_dir / FILE

    def load(self, server: str) -> Enrolment | None:
        """Return the enrolment at `server`, or None: never joined, or with another server."""
        found = self._read()
        if found is None or found.server != server or not known_hosts.pinned(self.known_hosts):
            return None
        return found

    def keep(self, enrolment: Enrolment, host_keys: list[HostKey]) -> None:
        """Keep `enrolment`; pin `host_keys` if nothing is pinned for this server yet, else compare."""
        before = known_hosts.pinned(self.known_hosts)
        if before and not self.is_of_other_server(enrolment.server):
            known_hosts.check(self.known_hosts, before, host_keys)
        else:
            known_hosts.pin(self.known_hosts, host_keys)
        text = json.dumps(asdict(enrolment), indent=1) + "\n"
        if text != read_text(self._file):
            write_atomic(self._file, text, 0o644)

    def is_of_other_server(self, server: str) -> bool:
        """Tell whether the settings name another server now than when the robot was enrolled."""
        found = self._read()
        return found is not None and found.server != server

    def _read(self) -> Enrolment | None:
        try:
            return _parse(parse_object(read_text(self._file) or "", FILE))
        except FieldError:
            # A broken file is as good as none: the server is asked again, and the pin still holds.
            return None


def _parse(obj: JsonObject) -> Enrolment:
    return Enrolment(
        server=get_match(obj, "server", SERVER, "a host"),
        robot=get_match(obj, "robot", ROBOT_NAME, "a robot's name"),
        mac=get_match(obj, "mac", MAC, "a MAC address"),
        ssh=parse_ssh(get_object(obj, "ssh")),
    )

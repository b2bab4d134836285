"""The MAC address that names this robot: found once and then kept, whatever interfaces come and go.

Used by the enroller and by `robotether-agent identity`. The settings `mac` and `interface` win; else the
address that was found first stays, so that a robot never becomes another one by itself.
"""

from __future__ import annotations

import json
import logging
from dataclasses import dataclass
from pathlib import Path

from robotether_agent.enrolment.identity import Interface, find_interface, interface_with
from robotether_agent.fields import FieldError, get_match, get_text, parse_object
from robotether_agent.files import read_text, write_atomic
from robotether_agent.problems import InterfaceMissing, StateUnusable
from robotether_agent.setting_values import MAC
from robotether_agent.settings import Settings

FILE = "identity.json"

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Identity:
    """The MAC that names this robot, and the interface that has it, or had it when `is_present` is False."""

    mac: str
    interface: str
    is_present: bool = True


class IdentityStore:
    """The file in `state_dir` that keeps what was found first."""

    def __init__(self, settings: Settings, root: Path = Path("/"), *, keeps: bool = True) -> None:
        self._settings = settings
        self._root = root
        self._keeps = keeps
        self._file = settings.state_dir / FILE

    def identity(self, enrolled_mac: str | None = None) -> Identity:
        """Return who this robot is; `enrolled_mac` stands in for a file that could not be written or is lost."""
        settings = self._settings
        if settings.mac is not None:
            # A person said so; in a container no interface may have it.
            return Identity(settings.mac, interface_with(settings.mac, self._root))
        kept = self._read() or self._adopted(enrolled_mac)
        if kept is None:
            return self._keep(self._find())
        if settings.interface not in {None, kept.interface}:
            return self._moved(kept)
        return self._as_it_is_now(kept)

    def is_kept(self, identity: Identity) -> bool:
        """Tell whether `identity` will be the same after a restart."""
        kept = self._read()
        return self._settings.mac is not None or (kept is not None and kept.mac == identity.mac)

    def _find(self) -> Interface:
        settings = self._settings
        return find_interface(
            settings.interface, allow_local=settings.allow_local_mac, root=self._root
        )

    def _moved(self, kept: Identity) -> Identity:
        """Follow the setting `interface` to another one, as soon as that is there."""
        try:
            return self._keep(self._find())
        except InterfaceMissing:
            return self._as_it_is_now(kept)

    def _as_it_is_now(self, kept: Identity) -> Identity:
        now = interface_with(kept.mac, self._root)
        return Identity(kept.mac, now or kept.interface, bool(now))

    def _adopted(self, enrolled_mac: str | None) -> Identity | None:
        if enrolled_mac is None:
            return None
        has_it = interface_with(enrolled_mac, self._root) or self._settings.interface or ""
        self._write(enrolled_mac, has_it)
        return Identity(enrolled_mac, has_it)

    def _keep(self, found: Interface) -> Identity:
        self._write(found.mac, found.name)
        return Identity(found.mac, found.name)

    def _write(self, mac: str, interface: str) -> None:
        text = json.dumps({"interface": interface, "mac": mac}) + "\n"
        try:
            if self._keeps and read_text(self._file) != text:
                write_atomic(self._file, text, 0o644)
        except StateUnusable as problem:
            # An enrolled robot has its MAC in the enrolment too, and a fresh one needs the disk for its key.
            log.debug("%s", problem)

    def _read(self) -> Identity | None:
        try:
            obj = parse_object(read_text(self._file) or "", FILE)
            mac = get_match(obj, "mac", MAC, "a MAC address")
            return Identity(mac, get_text(obj, "interface"))
        except FieldError:
            return None

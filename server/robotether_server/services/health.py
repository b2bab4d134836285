"""Judges how each part of the site is now, and says what to do, for the page Health. What nobody knows is unknown."""

from __future__ import annotations

import datetime as dt
import socket
import threading
import time
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import Literal

from msgspec import Struct

from robotether_server.backups import last_backup
from robotether_server.db import Transaction, cells
from robotether_server.db.cells import ALIVE_S, Cell
from robotether_server.disks import DATABASE_CURRENT_S, DiskSpace, recorded_space
from robotether_server.install_line import SiteCertificates
from robotether_server.problems import HistoryUnavailableError, SiteCertificateUnavailableError
from robotether_server.services.history import FiringAlert, Prometheus
from robotether_server.times import utc_now

# As in the alerts of images/prometheus/rules.yml.
CERTIFICATE_LEFT = dt.timedelta(days=14)
BACKUP_AGE = dt.timedelta(seconds=100_000)
MIN_DISK_FREE = 0.1
# Maximum time by which a machine's clock may be ahead of the database's.
MAX_CLOCK_AHEAD_S = 2.0
SSH_WITHIN_S = 2.0
# Time for which an answer of sshd counts: each question is a connection for it.
SSH_KEPT_S = 60.0
SSH_HELLO = b"SSH-2.0-health\r\n"
# What sshd says first, also with as many log-ins under way as it takes.
SSH_ANSWERS = (b"SSH-2.0-OpenSSH", b"Not allowed at this time")
ASK_RELAY = "On its machine, see docker compose ps and docker compose logs relay."
MAKE_ROOM = "On its machine, see docker system df, and delete what is not needed."
ASK_RECORDER = "On its machine, see docker compose logs recorder."

PartState = Literal["good", "bad", "unknown"]


class PartHealth(Struct, frozen=True):
    """One part of the site now, in words. `advice` says what to do; empty: nothing."""

    name: str
    state: PartState
    words: str
    advice: str = ""


class SiteHealth(Struct, frozen=True):
    """The site now. `alerts` are those that last; null: nobody works them out."""

    parts: list[PartHealth]
    alerts: list[FiringAlert] | None


class SshProbe:
    """Asks sshd through nginx, as robots behind a firewall do, now and then; safe to share between threads."""

    def __init__(self, endpoint: tuple[str, int]) -> None:
        self._endpoint = endpoint
        self._lock = threading.Lock()
        self._asked_at_s: float | None = None
        self._answers: bool | None = None

    def answers(self) -> bool | None:
        """Return whether it answers; None: what is there is no nginx of ours."""
        with self._lock:
            if self._asked_at_s is None or time.monotonic() - self._asked_at_s > SSH_KEPT_S:
                self._answers = self._ask()
                self._asked_at_s = time.monotonic()
            return self._answers

    def _ask(self) -> bool | None:
        try:
            connection = socket.create_connection(self._endpoint, SSH_WITHIN_S)
        except OSError:
            return None
        line = b""
        with connection, suppress(OSError):
            connection.sendall(SSH_HELLO)
            line = connection.recv(64)
        return line.startswith(SSH_ANSWERS) if not line or line.startswith(SSH_ANSWERS) else None


def read_health(
    tx: Transaction,
    certificates: SiteCertificates,
    ssh_probe: SshProbe,
    prometheus: Prometheus,
    *,
    backup_record: Path,
    database_record: Path,
) -> SiteHealth:
    """Judge all parts of the site."""
    parts = [
        PartHealth("web", "good", "It answers."),
        PartHealth("database", "good", "It answers."),
        _database_disk(recorded_space(database_record, DATABASE_CURRENT_S)),
        *chain.from_iterable(map(_of_cell, cells.read(tx))),
        _sshd(ssh_probe.answers()),
        _certificate(certificates),
        _backups(backup_record),
    ]
    try:
        alerts = prometheus.alerts()
    except HistoryUnavailableError:
        return SiteHealth([*parts, _prometheus(answers=False)], None)
    return SiteHealth([*parts, _prometheus(answers=True)], alerts)


def _database_disk(disk: DiskSpace | None) -> PartHealth:
    name = "disk of the database"
    if disk is None:
        words = "How full it is, is not known on this machine."
        return PartHealth(name, "unknown", words, "On the database's machine, see df.")
    return _judge_free(name, disk.free_part, f"{disk.free_part:.0%} of it is free.", MAKE_ROOM)


def _of_cell(cell: Cell) -> list[PartHealth]:
    return [_cell(cell), _recorder(cell), _disk(cell), _recordings(cell)]


def _cell(cell: Cell) -> PartHealth:
    name = f"cell {cell.name}"
    if not cell.is_alive:
        return PartHealth(
            name,
            "bad",
            f"Its relay has written nothing for {ALIVE_S} s.",
            ASK_RELAY,
        )
    if cell.clock_ahead_s is not None and abs(cell.clock_ahead_s) > MAX_CLOCK_AHEAD_S:
        return PartHealth(
            name,
            "bad",
            f"Its clock is {cell.clock_ahead_s:+.1f} s off the database's, so tickets of other cells may fail.",
            "Set up time synchronisation (NTP) on its machine.",
        )
    draining = " It is being taken out of service." if cell.draining else ""
    robots = "1 robot" if cell.robots == 1 else f"{cell.robots} robots"
    return PartHealth(name, "good", f"Its relay has {robots} online.{draining}")


def _sshd(answers: bool | None) -> PartHealth:
    if answers is None:
        return PartHealth(
            "sshd",
            "unknown",
            "It cannot be asked from here, as TLS_FRONT is not this site's nginx.",
            "See docker compose ps.",
        )
    if not answers:
        return PartHealth(
            "sshd",
            "bad",
            "It does not answer, so no robot can connect.",
            "See docker compose ps and docker compose logs sshd.",
        )
    return PartHealth("sshd", "good", "It answers.")


def _certificate(certificates: SiteCertificates) -> PartHealth:
    try:
        ends_at = certificates.own().ends_at
    except SiteCertificateUnavailableError:
        ends_at = None
    if ends_at is None:
        return PartHealth(
            "certificate", "unknown", "It cannot be read from here.", "See TLS_FRONT."
        )
    words = f"It ends on {ends_at:%Y-%m-%d}."
    if ends_at - utc_now() > CERTIFICATE_LEFT:
        return PartHealth("certificate", "good", words)
    advice = "Put a newer one there; with DOMAIN, see docker compose logs acme."
    return PartHealth("certificate", "bad", words, advice)


def _backups(record: Path) -> PartHealth:
    last, run_it = last_backup(record), "On the machine with the database, run tools/backup."
    if last is None:
        words = "When the last one was made is not known here."
        return PartHealth("backups", "unknown", words, run_it)
    if last.made_at is None:
        words = "None was made on this machine; they are made where the database is."
        return PartHealth("backups", "unknown", words, run_it)
    words = f"The last one on this machine is of {last.made_at:%Y-%m-%d %H:%M} UTC."
    if (age := utc_now() - last.made_at) < dt.timedelta():
        future = (
            f"{words} That is in the future by this machine's clock, so how old it is is not known."
        )
        return PartHealth("backups", "unknown", future, "See date on this machine.")
    if age < BACKUP_AGE:
        return PartHealth("backups", "good", words)
    return PartHealth("backups", "bad", words, run_it)


def _prometheus(*, answers: bool) -> PartHealth:
    if answers:
        return PartHealth("prometheus", "good", "It answers.")
    words = "It does not answer; history and alerts need it."
    return PartHealth("prometheus", "unknown", words, "Set COMPOSE_PROFILES=metrics.")


def _recorder(cell: Cell) -> PartHealth:
    name = f"recorder of {cell.name}"
    if cell.recorders is None:
        return PartHealth(name, "unknown", "The cell's relay does not say it.", ASK_RELAY)
    if cell.recorders:
        return PartHealth(name, "good", "It is connected to the cell's relay.")
    words = "It is not connected to the cell's relay, so nothing is recorded there."
    return PartHealth(name, "bad", words, ASK_RECORDER)


def _disk(cell: Cell) -> PartHealth:
    name = f"disk of {cell.name}"
    if cell.disk_free is None:
        return PartHealth(name, "unknown", "The cell's relay does not say it.", ASK_RELAY)
    words = f"{cell.disk_free:.0%} is free where the relay's volume is."
    return _judge_free(name, cell.disk_free, words, MAKE_ROOM)


def _recordings(cell: Cell) -> PartHealth:
    name = f"recordings of {cell.name}"
    if cell.recordings_free is None:
        words = "The cell's recorder does not say how much room they have."
        return PartHealth(name, "unknown", words, ASK_RECORDER)
    words = f"{cell.recordings_free:.0%} of their room is free: of RECORDINGS_MAX_GB, or of their disk if that is less."
    advice = "Delete recordings, or lower RECORDINGS_DAYS."
    return _judge_free(name, cell.recordings_free, words, advice)


def _judge_free(name: str, free: float, words: str, advice: str) -> PartHealth:
    if free >= MIN_DISK_FREE:
        return PartHealth(name, "good", words)
    return PartHealth(name, "bad", words, advice)

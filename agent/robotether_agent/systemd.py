"""Talks to systemd: the log for its journal, the agent's state (sd_notify), and the boot service (systemctl).

Without systemd the log goes to stderr with times, and the rest does nothing; a message that cannot be sent never stops
the agent.
"""

from __future__ import annotations

import asyncio
import logging
import os
import socket
import subprocess
import time
from collections.abc import Mapping

from robotether_common.log_handler import LogHandler

from robotether_agent.problems import UpgradeFailedError

SERVICE = "robotether-agent.service"
# Time limit for systemctl: TimeoutStopSec, then TimeoutStartSec.
TIMEOUT_S = 120.0
# syslog's numbers, which journald takes off the line again.
PRIORITIES = {
    logging.DEBUG: 7,
    logging.INFO: 6,
    logging.WARNING: 4,
    logging.ERROR: 3,
    logging.CRITICAL: 2,
}

log = logging.getLogger(__name__)


class JournalFormatter(logging.Formatter):
    """For the journal, which adds time and unit by itself."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the record with its priority in front of each line."""
        prefix = f"<{PRIORITIES.get(record.levelno, 6)}>"
        return "\n".join(prefix + line for line in super().format(record).splitlines())


def set_up_log(level: str, environ: Mapping[str, str]) -> None:
    """Send the log to stderr from `level` on, as readable sentences."""
    formatter = logging.Formatter(
        "%(asctime)s.%(msecs)03dZ %(levelname)s %(message)s", "%Y-%m-%dT%H:%M:%S"
    )
    formatter.converter = time.gmtime
    handler = LogHandler()
    handler.setFormatter(JournalFormatter() if "JOURNAL_STREAM" in environ else formatter)
    logging.basicConfig(level=level.upper(), handlers=[handler], force=True)
    # Its debug lines are about this process's own event loop.
    logging.getLogger("asyncio").setLevel(logging.WARNING)


class Notifier:
    """The socket that systemd named, if any."""

    def __init__(self, address: str | None, watchdog_s: float | None = None) -> None:
        # A leading @ means the abstract namespace.
        self._address = "\0" + address[1:] if address and address.startswith("@") else address
        self._watchdog_s = watchdog_s

    @classmethod
    def from_environ(cls, environ: Mapping[str, str]) -> Notifier:
        """Return the notifier that systemd asked for in `environ`."""
        usec = environ.get("WATCHDOG_USEC", "")
        for_us = environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        watchdog_s = int(usec) / 1e6 if for_us and usec.isdecimal() and int(usec) else None
        return cls(environ.get("NOTIFY_SOCKET") or None, watchdog_s)

    @property
    def is_service(self) -> bool:
        """Whether systemd started this process, and does so again when it ends."""
        return self._address is not None

    def ready(self) -> None:
        """Say that the service has started."""
        self._send("READY=1")

    def stopping(self) -> None:
        """Say that the service is about to end."""
        self._send("STOPPING=1")

    def status(self, text: str) -> None:
        """Set the line that `systemctl status` shows."""
        self._send(f"STATUS={text}")

    async def keep_watchdog(self) -> None:
        """Send a heartbeat at half the watchdog's time, for as long as the event loop runs."""
        while self._watchdog_s is not None:
            self._send("WATCHDOG=1")
            await asyncio.sleep(self._watchdog_s / 2)
        await asyncio.Event().wait()

    def _send(self, message: str) -> None:
        if self._address is None:
            return
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
                # A full queue of systemd must not stop the event loop.
                sender.setblocking(False)
                sender.sendto(message.encode(), self._address)
        except OSError as error:
            log.debug("cannot notify systemd of %s: %s", message, error)


def state() -> str | None:
    """Return the service's state in systemd's word (active, inactive, failed ...), None without systemd."""
    try:
        done = _systemctl("is-active", SERVICE)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() or None


def reload_units() -> None:
    """Let systemd read the unit files again."""
    _do("daemon-reload")


def restart() -> None:
    """Restart the service, and wait until it says that it is ready; raise UpgradeFailedError."""
    _do("restart", SERVICE)


def _do(*words: str) -> None:
    try:
        done = _systemctl(*words)
    except (OSError, subprocess.TimeoutExpired) as error:
        why = getattr(error, "strerror", None) or f"no end after {TIMEOUT_S:g} s"
        raise UpgradeFailedError(f"cannot run systemctl {' '.join(words)}: {why}") from error
    if done.returncode:
        raise UpgradeFailedError(
            f"cannot do systemctl {' '.join(words)}: {done.stderr.strip()}",
            advice="see: journalctl -u robotether-agent",
        )


def _systemctl(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(  # noqa: S603 - a fixed command, no shell
        ["systemctl", *words],  # noqa: S607 - where it is differs between distributions
        check=False,
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
    )

"""Asks systemd about the boot service and restarts it, by systemctl; for `switch` and `doctor`."""

from __future__ import annotations

import subprocess

from robotether_agent.problems import UpgradeFailed

SERVICE = "robotether-agent.service"
# Until it gives up on a service that does not end: TimeoutStopSec, then TimeoutStartSec.
TIMEOUT_S = 120.0


def state() -> str | None:
    """Return the service's state in systemd's word (active, inactive, failed ...), None without systemd."""
    try:
        done = _systemctl("is-active", SERVICE)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() or None


def reload_units() -> None:
    """Let systemd read the unit files anew."""
    _do("daemon-reload")


def restart() -> None:
    """Restart the service, and wait until it says that it is ready; raise UpgradeFailed."""
    _do("restart", SERVICE)


def _do(*words: str) -> None:
    try:
        done = _systemctl(*words)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise UpgradeFailed(f"cannot run systemctl {' '.join(words)}: {error}") from error
    if done.returncode:
        raise UpgradeFailed(
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

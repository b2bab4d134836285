"""Removes what makes a machine the robot that it is: key, enrolment, pinned host keys, kept MAC.

Called by `robotether-agent forget`. Never while an agent runs, which would go on with what it has in memory.
"""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

from robotether_agent.enrolment import enrolment_store, identity_store, keys, known_hosts
from robotether_agent.files import LOCK, only_one
from robotether_agent.problems import AlreadyRunning, StateUnusable
from robotether_agent.settings import Settings

# The private keys first: whatever stops this half-way, the machine has then ceased to be that robot.
FILES = (
    keys.NAME,
    keys.NEXT,
    f"{keys.NAME}.pub",
    f"{keys.NEXT}.pub",
    enrolment_store.FILE,
    known_hosts.FILE,
    identity_store.FILE,
)


def enrolment_files(state_dir: Path) -> list[Path]:
    """Return what there is to forget."""
    return [path for path in (state_dir / name for name in FILES) if path.exists()]


def unenrol(settings: Settings) -> None:
    """Remove all of it; raise AlreadyRunning while an agent holds the run directory's lock."""
    lock = settings.run_dir / LOCK
    try:
        # Without the lock file nothing runs: systemd removes the directory with the service.
        with only_one(lock) if lock.exists() else nullcontext():
            for path in enrolment_files(settings.state_dir):
                path.unlink()
    except AlreadyRunning as problem:
        raise AlreadyRunning(
            "cannot forget this robot: its agent runs",
            advice="stop it first: sudo systemctl stop robotether-agent",
        ) from problem
    except OSError as error:
        raise StateUnusable(
            f"cannot forget this robot: {error.filename}: {error.strerror}",
            advice="run this with sudo, and see that the disk is not read-only",
        ) from error

"""Reads and writes the agent's own small files, whole or not at all."""

from __future__ import annotations

import errno
import fcntl
import os
import stat
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from robotether_agent.problems import AlreadyRunningError, StateUnusableError

FULL_ADVICE = "make room (df, sudo journalctl --vacuum-size=100M)"
READ_ONLY = (
    "the disk is read-only",
    "mount it writable; Linux does that to a disk or memory card that fails (dmesg)",
)
# Reasons why this machine cannot open anything, a file or a connection, and what to do about it.
MACHINE_FAULTS: Mapping[int, tuple[str, str]] = {
    errno.EMFILE: (
        "this program has too many files and connections open",
        "restart it (sudo systemctl restart robotether-agent), and report it if that returns",
    ),
    errno.ENFILE: ("this machine has too many files open", "see what holds them: sudo lsof"),
    errno.ENOMEM: ("this machine has no memory left", "see what takes it: free, top"),
}
DISK_FAULTS: Mapping[int, tuple[str, str]] = {
    **MACHINE_FAULTS,
    errno.EROFS: READ_ONLY,
    errno.ENOSPC: ("the disk is full", FULL_ADVICE),
    errno.EDQUOT: ("this user's share of the disk is full", FULL_ADVICE),
    errno.EIO: ("the disk fails", "see dmesg, and replace the disk or memory card"),
}
NO_INODES = (
    "the disk has no inode left",
    "remove small files (df -i; sudo du --inodes -x / | sort -n | tail)",
)

# In the run directory, held by the agent that runs.
LOCK = "agent.lock"


def ensure_directory(path: Path, key: str, mode: int = 0o755) -> None:
    """Make the directory `path`, which the setting `key` names, unless it is there."""
    try:
        path.mkdir(mode=mode, parents=True, exist_ok=True)
    except OSError as error:
        raise disk_problem(
            f"cannot make the directory {path}",
            path.parent,
            error,
            advice=f"make it for the agent's user, or set {key} to a place that it may write",
        ) from error


def disk_problem(
    what: str, directory: Path, error: OSError, *, advice: str | None = None
) -> StateUnusableError:
    """Return the problem "cannot DO WHAT: why" of a file in `directory`.

    `advice` is for faults that are not the disk's: usually that the agent's user may not write there.
    """
    fault = DISK_FAULTS.get(error.errno or 0)
    if error.errno == errno.ENOSPC and _has_no_inodes(directory):
        fault = NO_INODES
    words = error.strerror or "no reason is known"
    if fault is not None:
        return StateUnusableError(f"{what}: {fault[0]} ({words})", advice=fault[1])
    usual = f"let the agent's user (uid {os.getuid()}) write in {directory}"
    return StateUnusableError(f"{what}: {words}", advice=usual if advice is None else advice)


def _has_no_inodes(directory: Path) -> bool:
    try:
        room = os.statvfs(directory)
    except OSError:
        return False
    return bool(room.f_files) and not room.f_favail


def write_atomic(path: Path, data: str, mode: int, *, lasts: bool = True) -> None:
    """Write `data` to `path`; a reader sees the old file or the new one, after a power cut too if it `lasts`."""
    try:
        _write(path, data, mode, lasts=lasts)
    except OSError as error:
        raise disk_problem(f"cannot write {path}", path.parent, error) from error


def remove(path: Path) -> None:
    """Remove `path`, if it is there; StateUnusableError when that fails."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise disk_problem(f"cannot remove {path}", path.parent, error) from error


def read_text(path: Path) -> str | None:
    """Return the text of `path`, or None when there is no such file, or no such process any more under /proc."""
    try:
        # What is damaged is for its reader to see, in whatever way it is.
        with os.fdopen(_open_regular(path), encoding="utf-8", errors="replace") as file:
            return file.read()
    except (FileNotFoundError, ProcessLookupError):
        return None
    except OSError as error:
        advice = f"run this with sudo, let the user with uid {os.getuid()} read it, or remove it if it is broken"
        raise disk_problem(f"cannot read {path}", path.parent, error, advice=advice) from error


def _open_regular(path: Path, flags: int = os.O_RDONLY) -> int:
    """Open a file that the agent's user may have replaced: root, who opens it too, must not wait at a pipe."""
    descriptor = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC, 0o644)
    if stat.S_ISREG(os.fstat(descriptor).st_mode):
        return descriptor
    os.close(descriptor)
    raise OSError(errno.EINVAL, "it is no regular file", str(path))


@contextmanager
def only_one(path: Path, who: str = "agent") -> Iterator[None]:
    """Hold the lock file `path`, or raise AlreadyRunningError; the kernel frees it with the process."""
    try:
        file = os.fdopen(_open_regular(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW), "r+")
    except OSError as error:
        raise disk_problem(f"cannot open the lock {path}", path.parent, error) from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise AlreadyRunningError(
                f"cannot start: another {who} holds {path}",
                advice="stop it first, or give this one its own run_dir and state_dir"
                if who == "agent"
                else "wait until it has ended",
            ) from error
        yield


def _write(path: Path, data: str, mode: int, *, lasts: bool) -> None:
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    temporary = Path(name)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            os.fchmod(file.fileno(), mode)
            file.write(data)
            if lasts:
                file.flush()
                os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    if lasts:
        # The new name, too.
        sync(path.parent)


def sync(path: Path) -> None:
    """Keep what a file or a directory holds now through a power cut."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)

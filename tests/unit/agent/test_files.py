"""Small files, whole or not at all."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from robotether_agent.files import only_one, read_text, write_atomic
from robotether_agent.problems import StateUnusableError


def test_the_new_name_is_on_the_disk_too(place, monkeypatch):
    """Without it a power cut could bring the robot back without its stop."""
    synced = []
    fsync = os.fsync

    def note(descriptor):
        synced.append(Path(f"/proc/self/fd/{descriptor}").readlink())
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", note)
    write_atomic(place / "a", "one", 0o600)
    assert synced[-1] == place.resolve()


def test_a_pipe_in_a_files_place_keeps_nobody_waiting(place):
    """Root reads and locks the agent's files too, and whoever replaced one must not hold root up."""
    os.mkfifo(place / "pipe")
    with pytest.raises(StateUnusableError, match="no regular file"):
        read_text(place / "pipe")
    with pytest.raises(StateUnusableError, match="no regular file"), only_one(place / "pipe"):
        pass


def test_a_failed_write_leaves_nothing(place):
    (place / "a").mkdir()
    with pytest.raises(StateUnusableError, match=r"cannot write .*let the agent's user"):
        write_atomic(place / "a", "one", 0o644)
    assert [path.name for path in place.iterdir()] == ["a"]


@pytest.mark.parametrize(
    ("mount", "before", "told"),
    [
        ("size=4k", "head -c 4096 /dev/zero > full", "the disk is full"),
        ("nr_inodes=2", "touch one", "the disk has no inode left"),
        ("size=1m", "mount -o remount,ro .", "the disk is read-only"),
    ],
)
def test_a_disk_that_half_works_is_told_by_its_fault(place, mount, before, told):
    script = (
        f"mount -t tmpfs -o {mount} tmpfs {place} && cd {place} && {{ {before}; }} && "
        f"exec {sys.executable} -c 'import sys; sys.path[:] = sys.argv[1:]; from pathlib import Path; "
        'from robotether_agent.files import write_atomic; write_atomic(Path("a"), "x" * 9000, 0o600)\' "$@"'
    )
    command = ["unshare", "--map-root-user", "--mount", "sh", "-c", script, "sh", *sys.path]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    problem = done.stderr.splitlines()[-1]
    assert f"cannot write a: {told} (" in problem
    assert "let the agent's user" not in problem

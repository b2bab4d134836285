#!/usr/bin/env python3
"""Downloads what the agent needs on robots of one architecture: tools/agent_wheelhouse.py amd64|arm64 FOLDER [--video].

The wheels of agent/requirements.txt, checked by its hashes, for each Python that the agent's Debian package supports:
a robot without a package index installs from the folder. With --video also those of requirements.video.txt, for H.264.
Needs pip, and no other package.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from operator import ge, lt
from pathlib import Path

AGENT = Path(__file__).resolve().parents[1] / "agent"
VIDEO = "--video"
MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}
# Of Python 3; the bounds of the dependency in tools/build_agent_deb.
MINORS = (10, 11, 12, 13)
# The oldest C library among the robots' distributions, Ubuntu 22.04's, knows all of these.
PLATFORMS = ("manylinux2014", "manylinux_2_17", "manylinux_2_28")
MARKER = re.compile(r" ; python_full_version (<|>=) '3\.(\d+)'")
COMPARE = {"<": lt, ">=": ge}


def lock_for(minor: int, lock: str) -> str:
    """Return the lock's entries for this Python, without markers: pip would compare those with its own Python."""
    entries = []
    for entry in re.split(r"^(?=\S)", lock, flags=re.MULTILINE):
        marker = MARKER.search(entry)
        if marker is None or COMPARE[marker[1]](minor, int(marker[2])):
            entries.append(MARKER.sub("", entry))
    return "".join(entries)


def download(machine: str, minor: int, folder: Path, locked: str) -> None:
    """Fill the folder; CalledProcessError after pip has said why not."""
    platforms = [word for name in PLATFORMS for word in ("--platform", f"{name}_{machine}")]
    with tempfile.NamedTemporaryFile("w", suffix=".txt") as lock:
        lock.write(lock_for(minor, locked))
        lock.flush()
        command = [
            sys.executable,
            "-m",
            "pip",
            "download",
            "--quiet",
            "--disable-pip-version-check",
        ]
        command += ["--no-deps", "--only-binary", ":all:", "--require-hashes", "-r", lock.name]
        command += ["--implementation", "cp", "--python-version", f"3.{minor}", *platforms]
        subprocess.run([*command, "--dest", str(folder)], check=True)


def main() -> int:
    """Return the exit code."""
    if "--help" in sys.argv:
        print(__doc__)
        return 0
    words = [word for word in sys.argv[1:] if word != VIDEO]
    if len(words) != 2 or words[0] not in MACHINES:  # noqa: PLR2004 - the two arguments
        print(__doc__.splitlines()[0], file=sys.stderr)
        return 2
    folder = Path(words[1])
    locks = ["requirements.txt", *(["requirements.video.txt"] if VIDEO in sys.argv else [])]
    locked = "".join((AGENT / name).read_text() for name in locks)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for minor in MINORS:
            download(MACHINES[words[0]], minor, folder, locked)
    except subprocess.CalledProcessError:
        print(f"cannot fill {folder}: see pip's message above", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"cannot fill {folder}: {error.strerror}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())

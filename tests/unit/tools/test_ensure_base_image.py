"""tools/ensure_base_image where no registry answers: a real Docker, and a program in the place of mmdebstrap."""

from __future__ import annotations

import json
import os
import re
import shutil
from pathlib import Path

import docker
import pytest
from commands import path_with, run_command, write_programs
from docker.errors import ImageNotFound

ROOT = Path(__file__).resolve().parents[3]
TOOL = ROOT / "tools" / "ensure_base_image"
# Nobody has a release of this name, nor does another run.
SUITE = f"nowhere{os.getpid()}"
IMAGE = f"debian:{SUITE}-slim"
DOCKER = """#!/bin/sh
[ "$1" != pull ] || exit 1
exec {docker} "$@"
"""
# An engine beside a registry: it has an image with these digests, and pulls what it is told to.
REGISTRY = """#!/bin/sh
echo "$@" >> {folder}/calls
case "$*" in *.Size*) echo 99000000 ;; *.RepoDigests*) echo 'DIGESTS' ;; esac
"""
# Also where the tests' user is not root; the real one forgets the PATH.
SUDO = """#!/bin/sh
[ "$1" != -v ] || exit 0
exec "$@"
"""
APT_GET = """#!/bin/sh
echo 'http://mirror.invalid/debian/|main|Debian'
"""
MAKES = """#!/bin/sh
head -c 12000000 /dev/zero > {folder}/file
tar -C {folder} -c file
"""
BREAKS = """#!/bin/sh
head -c 4096 /dev/zero
echo 'E: the mirror is gone' >&2
exit 25
"""


class Machine:
    """A machine without a registry, where the tool runs: its PATH has these programs first."""

    def __init__(self, folder):
        self.folder = folder
        self.put(docker=DOCKER, sudo=SUDO)
        self.put(**{"apt-get": APT_GET})

    def put(self, **programs):
        places = {"folder": self.folder, "docker": shutil.which("docker")}
        filled = {name: text.format(**places) for name, text in programs.items()}
        write_programs(self.folder / "bin", filled)

    def ensure(self, suite=SUITE):
        """Run the tool."""
        env = {**os.environ, **path_with(self.folder / "bin"), "TMPDIR": str(self.folder)}
        return run_command(TOOL, suite, env=env)


@pytest.fixture
def engine():
    """A Docker that has not got the image, and has not got it afterwards."""
    client = docker.from_env()
    yield client
    if client.images.list(IMAGE):
        client.images.remove(IMAGE, force=True)
    client.close()


@pytest.fixture
def machine(tmp_path):
    return Machine(tmp_path)


def test_image_is_whole_or_not_there(machine, engine):
    """What failed once is tried again, and does not count as done."""
    machine.put(mmdebstrap=BREAKS)
    done = machine.ensure()
    assert done.returncode != 0
    assert "E: the mirror is gone" in done.stderr
    assert f"cannot make {IMAGE}: mmdebstrap failed" in done.stderr
    with pytest.raises(ImageNotFound):
        engine.images.get(IMAGE)
    machine.put(mmdebstrap=MAKES)
    done = machine.ensure()
    assert done.returncode == 0, done.stderr
    assert engine.images.get(IMAGE).attrs["Size"] >= 12_000_000
    assert "nothing to do" in machine.ensure().stdout
    assert list(machine.folder.glob("*.tar")) == []


@pytest.mark.parametrize(
    ("digests", "pulls"),
    [("[]", False), ("[debian@{digest}]", False), ("[debian@sha256:1234]", True)],
)
def test_base_of_a_registry_is_the_one_of_this_commit(machine, digests, pulls):
    """Renovate moves the digest; an image that was made here has none, and stays."""
    [digest] = re.findall("sha256:[0-9a-f]{64}", TOOL.read_text())
    config = json.loads((ROOT / "renovate.json").read_text())["customManagers"][0]
    [pattern] = config["matchStrings"]
    assert re.search(pattern.replace("?<", "?P<"), TOOL.read_text())["currentDigest"] == digest
    machine.put(docker=REGISTRY.replace("DIGESTS", digests.format(digest=digest)))
    assert machine.ensure("trixie").returncode == 0
    calls = (machine.folder / "calls").read_text()
    assert (f"pull --quiet debian@{digest}" in calls) == pulls
    assert (f"tag debian@{digest} debian:trixie-slim" in calls) == pulls

"""tools/ensure_base_image, with a program in the place of Docker."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import pytest
from commands import path_with, run_command, write_programs

ROOT = Path(__file__).resolve().parents[3]
TOOL = ROOT / "tools" / "ensure_base_image"
# An engine beside a registry: it has an image with these digests, and pulls what it is told to.
DOCKER = """#!/bin/sh
echo "$@" >> {folder}/calls
case "$*" in *.Size*) echo 99000000 ;; *.RepoDigests*) echo '{digests}' ;; esac
"""


@pytest.mark.parametrize(
    ("digests", "pulls"),
    [("[]", False), ("[debian@{digest}]", False), ("[debian@sha256:1234]", True)],
)
def test_base_of_a_registry_is_the_one_of_this_commit(tmp_path, digests, pulls):
    """Renovate moves the digest; an image that was made here has none, and stays."""
    [digest] = re.findall("sha256:[0-9a-f]{64}", TOOL.read_text())
    config = json.loads((ROOT / "renovate.json").read_text())["customManagers"][0]
    [pattern] = config["matchStrings"]
    assert re.search(pattern.replace("?<", "?P<"), TOOL.read_text())["currentDigest"] == digest
    docker = DOCKER.format(folder=tmp_path, digests=digests.format(digest=digest))
    write_programs(tmp_path / "bin", {"docker": docker})
    env = {**os.environ, **path_with(tmp_path / "bin"), "TMPDIR": str(tmp_path)}
    done = run_command(TOOL, "trixie", env=env)
    assert done.returncode == 0, done.stderr
    calls = (tmp_path / "calls").read_text()
    assert (f"pull --quiet debian@{digest}" in calls) == pulls
    assert (f"tag debian@{digest} debian:trixie-slim" in calls) == pulls

"""Benchmarks run rarely; that they start shows here. What they import of the product is mypy's part of tools/lint."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest


@pytest.mark.parametrize(
    ("verb", "program"), [("bench", "bench.py"), ("experiments", "paper.experiments")]
)
def test_program_starts_with_the_path_that_make_gives(verb: str, program: str) -> None:
    """Pytest has one of its own, which hides what `make bench` cannot find."""
    root = Path(__file__).parents[2]
    asked = ["make", "--dry-run", verb]
    said = subprocess.run(asked, cwd=root, check=True, capture_output=True, text=True).stdout
    commands = said.replace("\\\n", "").splitlines()
    [command] = [line for line in commands if program in line]
    words = ["bash", "-c", f"{command} --help"]
    done = subprocess.run(words, cwd=root, check=False, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()

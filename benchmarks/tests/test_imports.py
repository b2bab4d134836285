"""Benchmarks run rarely; that what they import of the product is still there shows here."""

from __future__ import annotations

import importlib
import subprocess
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1]
MODULES = [
    ".".join(path.relative_to(BENCHMARKS).with_suffix("").parts)
    for path in sorted([*BENCHMARKS.glob("*.py"), *BENCHMARKS.glob("paper/**/*.py")])
]


@pytest.mark.parametrize("module", MODULES)
def test_module_finds_what_it_imports(module: str) -> None:
    importlib.import_module(module)


@pytest.mark.parametrize(
    ("verb", "program"), [("bench", "bench.py"), ("experiments", "paper.experiments")]
)
def test_program_starts_with_the_path_that_make_gives(verb: str, program: str) -> None:
    """Pytest has one of its own, which hides what `make bench` cannot find."""
    root = BENCHMARKS.parent
    asked = ["make", "--dry-run", verb]
    said = subprocess.run(asked, cwd=root, check=True, capture_output=True, text=True).stdout
    commands = said.replace("\\\n", "").splitlines()
    [command] = [line for line in commands if program in line]
    words = ["bash", "-c", f"{command} --help"]
    done = subprocess.run(words, cwd=root, check=False, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()

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
    # It gives pytest options, which the tests have not got.
    if path.name not in ("conftest.py", "experiments.py")
]


@pytest.mark.parametrize("module", MODULES)
def test_module_finds_what_it_imports(module: str) -> None:
    importlib.import_module(module)


def test_bench_starts_with_the_path_that_make_gives() -> None:
    """Pytest has one of its own, which hides what `make bench` cannot find."""
    asked = ["make", "--dry-run", "bench", "BENCH=--help"]
    root = BENCHMARKS.parent
    lines = subprocess.run(asked, cwd=root, check=True, capture_output=True, text=True).stdout
    command = next(line for line in lines.splitlines() if "bench.py" in line)
    done = subprocess.run(["bash", "-c", command], cwd=root, check=False, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()

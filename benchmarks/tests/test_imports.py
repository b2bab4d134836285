"""Benchmarks run rarely; that what they import of the product is still there shows here."""

from __future__ import annotations

import importlib
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

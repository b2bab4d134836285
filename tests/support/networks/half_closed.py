"""Hooks for a conftest whose tests kill the other side of a TLS connection: the test's own client stays half closed.

The killed side never answers TLS's goodbye before the test's loop ends, so its transport is collected unclosed.
"""

from __future__ import annotations

import gc
import warnings

import pytest


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("filterwarnings", "ignore:unclosed:ResourceWarning")


def pytest_sessionfinish() -> None:
    """Collect what the last test left so; at pytest's own collection, later, the filter above is gone."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "unclosed", ResourceWarning)
        gc.collect()

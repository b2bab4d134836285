"""Grants, groups and sites in the real database."""

import pytest
from robotether_server.db import grants


@pytest.mark.parametrize(
    ("held", "asked", "may"),
    [
        ("observe", "observe", True),
        ("observe", "drive", False),
        ("drive", "observe", True),
        ("drive", "drive", True),
        ("drive", "manage", False),
        ("manage", "drive", True),
    ],
)
def test_level_includes_the_lower_ones(held, asked, may):
    assert grants.includes(held, asked) is may

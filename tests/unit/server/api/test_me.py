"""Who asks."""

from __future__ import annotations

import pytest
from robotether_server.db import Database
from web_visitor import Browser, bearer


@pytest.mark.parametrize(("user", "role"), [("ann", "user"), ("root", "admin")])
def test_program_hears_who_it_is(
    program: Browser, database: Database, user: str, role: str
) -> None:
    """Name and role, nothing else."""
    answer = program.ask("GET", "/api/v1/me", headers=bearer(database, user))
    assert answer.json == {"name": user, "role": role}

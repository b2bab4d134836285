"""Drives, as programs ask for them."""

from __future__ import annotations

import csv
import io
import json

import pytest
from api_visitor import Program
from drive_records import add_drive
from robotether_server.db import Database


@pytest.fixture
def drives(root: Program, ann: Program, admin_database: Database) -> list[int]:
    """Ann's of sim1 and somebody's of sim2; their numbers. The programs come first: they make the users."""
    assert root
    assert ann
    return [add_drive(admin_database, "sim1", "ann"), add_drive(admin_database, "sim2", "zoe")]


def test_managers_see_their_robots_and_admins_all(
    root: Program, ann: Program, drives: list[int]
) -> None:
    """A manager sees a robot as soon as the grant exists."""
    assert [drive["id"] for drive in root.get("/drives")["drives"]] == drives[::-1]
    root.ask("PUT", "/grants/ann/sim2", {"level": "drive"})
    assert len(ann.get("/drives")["drives"]) == 1
    root.ask("PUT", "/grants/ann/sim2", {"level": "manage"})
    assert len(ann.get("/drives")["drives"]) == 2


@pytest.mark.usefixtures("drives")
@pytest.mark.parametrize(
    ("query", "found"),
    [
        ("robot=sim1", 1),
        ("user=zoe", 1),
        ("robot=sim1&user=zoe", 0),
        ("limit=1", 1),
        ("fence=13", 2),
        ("robot=sim1&fence=13", 1),
        ("fence=14", 0),
        ("since=2026-01-31T12:00:00Z", 2),
        ("until=2026-01-31T12:00:00Z", 0),
        ("before=1", 0),
    ],
)
def test_drives_are_chosen(root: Program, query: str, found: int) -> None:
    """The filter holds in the list and in both files."""
    assert len(root.get(f"/drives?{query}")["drives"]) == found
    lines = root.ask("GET", f"/drives?{query}&format=jsonl").text.splitlines()
    assert [json.loads(line) for line in lines] == root.get(f"/drives?{query}")["drives"]
    rows = list(csv.DictReader(io.StringIO(root.ask("GET", f"/drives?{query}&format=csv").text)))
    assert len(rows) == found
    assert all(float(row["distance_m"]) == 12.34 for row in rows)


def test_one_drive_is_a_file(root: Program, ann: Program, drives: list[int]) -> None:
    """With what the list says of it; drives of others are not there."""
    answer = ann.ask("GET", f"/drives/{drives[0]}")
    assert [answer.json] == ann.get("/drives")["drives"]
    name = f"robotether-drive-{drives[0]}.json"
    assert answer.headers["Content-Disposition"] == f'attachment; filename="{name}"'
    assert root.get(f"/drives/{drives[1]}")["user"] == "zoe"
    for number in (drives[1], drives[1] + 1, 2**63, 10**30):
        assert ann.refused("GET", f"/drives/{number}") == (404, "record_missing")


def test_file_of_a_user_has_her_own_alone(ann: Program, drives: list[int]) -> None:
    """The file of a user has only her own drives, as the list does."""
    lines = ann.ask("GET", "/drives?format=jsonl").text.splitlines()
    assert [json.loads(line)["id"] for line in lines] == drives[:1]

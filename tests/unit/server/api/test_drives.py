"""Drives, as programs ask for them."""

import csv
import io
import json

import pytest
from drive_records import add_drive


@pytest.fixture
def drives(root, ann, admin_database):
    """Ann's of sim1 and somebody's of sim2; their numbers. The programs come first: they make the users."""
    assert root
    assert ann
    return [add_drive(admin_database, "sim1", "ann"), add_drive(admin_database, "sim2", "zoe")]


@pytest.mark.usefixtures("drives")
def test_each_filter_reaches_the_search(root):
    mac = root.get("/robots/sim1")["mac"]
    for query, found in (
        ("fence=13&since=2026-01-31T12:00:00Z", 2),
        ("robot=sim1", 1),
        (f"mac={mac}", 1),
        (f"robot=sim2&mac={mac}", 0),
        ("robot=sim1&user=zoe", 0),
        ("limit=1", 1),
        ("fence=14", 0),
        ("since=2026-01-31T12:00:01Z", 0),
        ("until=2026-01-31T12:00:00Z", 0),
        ("before=1", 0),
    ):
        listed = root.get(f"/drives?{query}")["drives"]
        assert len(listed) == found, query
        lines = root.ask("GET", f"/drives?{query}&format=jsonl").text.splitlines()
        assert [json.loads(line) for line in lines] == listed
        text = root.ask("GET", f"/drives?{query}&format=csv").text
        rows = csv.DictReader(io.StringIO(text))
        assert [float(row["distance_m"]) for row in rows] == [12.34] * found


def test_others_drives_are_not_there(root, ann, drives):
    assert [ann.get(f"/drives/{drives[0]}")] == ann.get("/drives")["drives"]
    assert root.get(f"/drives/{drives[1]}")["user"] == "zoe"
    for number in (drives[1], drives[1] + 1, 2**63, 10**30):
        assert ann.refused("GET", f"/drives/{number}") == (404, "record_missing")

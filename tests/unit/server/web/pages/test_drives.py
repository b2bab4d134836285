"""The page of drives, for everybody with a login."""

from drive_records import add_drive


def test_what_nobody_measured_is_not_claimed(admin, admin_database):
    measured = ("latency_p50_ms", "latency_p95_ms", "bytes", "pictures", "picture_bytes")
    seen = ("seen_p50_ms", "seen_p95_ms", "seen_p99_ms", "seen_max_ms", "seen_unknown", "slowed_s")
    add_drive(admin_database, "sim1", "ann", **dict.fromkeys((*measured, *seen, "viewed_s")))
    page = admin.ask("GET", "/drives").text
    facts = ("Round trip", "Seen", "Seen, unknown for", "Slowed", "Video", "Data")
    assert [words for words in facts if f"<dt>{words}<" in page] == []

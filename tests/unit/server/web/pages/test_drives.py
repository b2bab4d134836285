"""The page of drives, for everybody with a login."""

from drive_records import add_drive


def test_admin_sees_all_and_user_her_own(admin, ann, admin_database):
    add_drive(admin_database, "sim2", "zoe")
    page = admin.ask("GET", "/drives").text
    for text in (
        "10 min 0 s",
        "somebody else got control",
        "(code lease_lost)",
        "140 ms ago; 95 % within 210 ms, at most 512 ms",
        "2 too old, 3 to a topic that is not allowed",
    ):
        assert text in page
    assert "There is no drive yet" in ann.ask("GET", "/drives").text
    assert "Nothing matches" in ann.ask("GET", "/drives?robot=sim2").text
    add_drive(admin_database, "sim1", "ann", ended_at=None, stops=1)
    page = ann.ask("GET", "/drives").text
    assert "ongoing" in page
    assert "1 stop" in page
    assert "zoe" not in page
    assert "/admin/" not in page


def test_what_nobody_measured_is_not_claimed(admin, admin_database):
    measured = ("latency_p50_ms", "latency_p95_ms", "bytes", "pictures", "picture_bytes")
    seen = ("seen_p50_ms", "seen_p95_ms", "seen_p99_ms", "seen_max_ms", "seen_unknown", "slowed_s")
    add_drive(admin_database, "sim1", "ann", **dict.fromkeys((*measured, *seen, "viewed_s")))
    page = admin.ask("GET", "/drives").text
    facts = ("Round trip", "Seen", "Seen, unknown for", "Slowed", "Video", "Data")
    assert [words for words in facts if f"<dt>{words}<" in page] == []

"""Paths into a robot's settings."""

from __future__ import annotations

from robotether_server.setting_paths import get_path, is_in, put_path, remove_path

SETTINGS = {"shell_user": "pi", "guard": {"max_speed_m_s": None, "deadman_ms": 300}}


def test_paths_lead_to_values() -> None:
    """Null is a value; what is not there is none."""
    assert get_path(SETTINGS, "guard.deadman_ms") == 300
    assert get_path(SETTINGS, "guard.deadman_ms.x") is None
    for path in ("shell_user", "guard", "guard.max_speed_m_s"):
        assert is_in(SETTINGS, path)
    for path in ("policy.drive.call", "guard.", ".guard", "", "policy"):
        assert not is_in(SETTINGS, path)


def test_values_are_put_where_they_belong() -> None:
    """Beside what is there, or in the place of what stands in their way; what was given stays."""
    assert put_path(SETTINGS, "guard.deadman_ms", 400) == {
        "shell_user": "pi",
        "guard": {"max_speed_m_s": None, "deadman_ms": 400},
    }
    assert put_path({"guard": 5}, "guard.deadman_ms", 400) == {"guard": {"deadman_ms": 400}}
    assert put_path({}, "policy.drive.call", []) == {"policy": {"drive": {"call": []}}}
    assert put_path({}, "guard.", 1) == {"guard": {"": 1}}
    assert get_path(SETTINGS, "guard.deadman_ms") == 300


def test_values_are_taken_out() -> None:
    """Nothing happens where nothing stands."""
    assert remove_path(SETTINGS, "shell_user") == {"guard": SETTINGS["guard"]}
    assert remove_path(SETTINGS, "guard.deadman_ms") == {
        "shell_user": "pi",
        "guard": {"max_speed_m_s": None},
    }
    for path in ("policy.drive", "guard.deadman_ms.x", "guard."):
        assert remove_path(SETTINGS, path) == SETTINGS

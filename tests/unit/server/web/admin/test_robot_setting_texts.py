"""A robot's settings as texts."""

from __future__ import annotations

import pytest
from robotether_server.web.admin.robot_setting_texts import is_in, look_up, summary, text_of

SETTINGS = {"guard": {"max_speed_m_s": None, "deadman_ms": 300}}


def test_paths_lead_to_values() -> None:
    """Null is a value; what is not there is none."""
    assert look_up(SETTINGS, "guard.deadman_ms") == 300
    assert look_up(SETTINGS, "guard.deadman_ms.x") is None
    assert is_in(SETTINGS, "guard.max_speed_m_s")
    assert not is_in(SETTINGS, "policy.drive.call")


@pytest.mark.parametrize(
    ("value", "text"), [(None, ""), (0.5, "0.5"), (2.0, "2"), (300, "300"), (["/a", "*"], "/a\n*")]
)
def test_values_are_texts_as_a_field_takes_them(value: object, text: str) -> None:
    """Numbers without needless zeros."""
    assert text_of(value) == text


def test_summary_has_what_differs() -> None:
    """In words; the defaults are nothing, and what is no setting is said."""
    assert summary({}) == []
    assert summary({"guard": {"deadman_ms": 300}, "policy": {"manage": {"call": []}}}) == [
        ("Guard on the robot: Stop without commands after (ms)", "300"),
        ("Managers: Call", "none"),
    ]
    assert summary({"guard": {"deadman_ms": 5}})[0][0] == "Not valid"

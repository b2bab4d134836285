"""A robot's settings as texts."""

from __future__ import annotations

import pytest
from robotether_server.web.admin.robot_setting_texts import summary, text_of


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, ""),
        (0.5, "0.5"),
        (2.0, "2"),
        (0.12345678, "0.12345678"),
        (300, "300"),
        (["/a", "*"], "/a\n*"),
    ],
)
def test_values_are_texts_as_a_field_takes_them(value: object, text: str) -> None:
    """Numbers without needless zeros, and with all their digits."""
    assert text_of(value) == text


def test_summary_has_what_differs() -> None:
    """In words; the defaults are nothing, and what is no setting is said."""
    assert summary({}) == []
    assert summary({"guard": {"deadman_ms": 300}, "policy": {"manage": {"call": []}}}) == [
        ("Guard on the robot: Stop without commands after (ms)", "300"),
        ("Managers: Call", "none"),
    ]
    assert summary({"guard": {"deadman_ms": 5}})[0][0] == "Not valid"

"""The fields of the form for policy and guard."""

from __future__ import annotations

import pytest
from robotether_server.robot_settings import DEFAULTS, get_path
from robotether_server.web.admin.robot_setting_fields import SECTIONS, SettingField, summary

FIELDS = [field for section in SECTIONS for field in section.fields]


@pytest.mark.parametrize("field", FIELDS, ids=lambda field: field.path)
def test_field_is_of_the_kind_of_its_default(field: SettingField) -> None:
    """Names are a list, a limit may be none, a whole number never is; and each says what it means."""
    default = get_path(DEFAULTS.as_dict(), field.path)
    kinds = {"globs": list, "limit": type(None), "whole": int}
    assert isinstance(default, kinds[field.kind])
    assert field.label
    assert field.hint.endswith(".")


def test_summary_has_what_differs() -> None:
    """In words; the defaults are nothing, and what is no setting is said."""
    assert summary({}) == []
    assert summary({"guard": {"deadman_ms": 300}, "policy": {"manage": {"call": []}}}) == [
        ("Guard on the robot: Stop if no command arrives for (ms)", "300"),
        ("Managers: Call", "none"),
    ]
    assert summary({"guard": {"deadman_ms": 5}})[0][0] == "Not valid"

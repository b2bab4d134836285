"""The fields of a robot's settings."""

from collections.abc import Mapping

import pytest
from robotether_server.settings.robot import DEFAULTS, get_path
from robotether_server.web.pages.setting_fields import (
    CAMERAS,
    CAMERAS_PATH,
    DRIVING,
    HELP,
    PERMISSIONS,
    SAFETY,
)


def leaves(settings, above):
    found = []
    for name, value in settings.items():
        inner = isinstance(value, Mapping)
        found += leaves(value, f"{above}{name}.") if inner else [above + name]
    return found


@pytest.mark.parametrize(
    ("part", "tabs", "own"),
    [
        ("guard", [SAFETY], []),
        ("policy", [PERMISSIONS], []),
        ("page", [CAMERAS, DRIVING], [CAMERAS_PATH]),
        ("help", [HELP], []),
    ],
)
def test_every_setting_has_its_field(part, tabs, own):
    present = leaves(get_path(DEFAULTS.as_dict(), part), f"{part}.")
    assert sorted([*own, *(field.path for tab in tabs for field in tab.fields)]) == sorted(present)

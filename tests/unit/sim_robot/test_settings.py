"""A wrong variable of the environment stops the start."""

import re
from pathlib import Path

import pytest
import sim_robot
from sim_robot.settings import SimSettingsError, from_environment, variable_names


@pytest.mark.parametrize(
    ("variable", "value", "says"),
    [
        ("SIM_WORLD_SIZE_M", "nan", "'nan', allowed is a number from 2 to 1000"),
        ("SIM_KIND", "legged", "'legged', allowed is differential or holonomic or ackermann"),
        ("SIM_VIDEO_PORT", "65536", "'65536', allowed is a port from 1 to 65535"),
        ("SIM_VIDEOPORT", "1", "not a setting; known are SIM_NAME"),
    ],
)
def test_wrong_variable_is_named_with_what_is_allowed(variable, value, says):
    with pytest.raises(SimSettingsError, match=f"cannot start: {variable} is {says}"):
        from_environment({variable: value})


def test_readme_lists_every_variable() -> None:
    readme = Path(sim_robot.__file__).parents[1] / "README.md"
    rows = re.findall(r"^\| `(SIM_\w+)`", readme.read_text(), re.MULTILINE)
    assert rows == list(variable_names())

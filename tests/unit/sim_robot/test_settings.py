"""The environment is read once; a wrong value stops the start."""

import re
from pathlib import Path

import pytest
import sim_robot
from sim_robot.settings import SimSettings, SimSettingsError, from_environment, variable_names


def test_every_variable_is_read() -> None:
    settings = from_environment({
        "SIM_NAME": "r2", "SIM_WORLD_SIZE_M": "11.5", "SIM_KIND": "holonomic", "SIM_ROS_VERSION": "1",
        "SIM_BIND_ADDRESS": "127.0.0.1", "SIM_ROSBRIDGE_PORT": "1", "SIM_VIDEO_PORT": "2", "SIM_CAMERA_FPS": "5",
        "SIM_LOG_LEVEL": "debug", "SIM_CAMERAS": "0",
    })  # fmt: skip
    assert settings == SimSettings("r2", 11.5, "holonomic", 1, 0, "127.0.0.1", 1, 2, 5.0, "debug")


@pytest.mark.parametrize(
    ("variable", "value", "allowed"),
    [
        ("SIM_WORLD_SIZE_M", "big", "2 to 1000"),
        ("SIM_WORLD_SIZE_M", "nan", "2 to 1000"),
        ("SIM_WORLD_SIZE_M", "1", "2 to 1000"),
        ("SIM_KIND", "legged", "differential or holonomic or ackermann"),
        ("SIM_ROS_VERSION", "3", "1 or 2"),
        ("SIM_CAMERAS", "4", "0 or 1 or 2 or 3"),
        ("SIM_ROSBRIDGE_PORT", "http", "1 to 65535"),
        ("SIM_VIDEO_PORT", "65536", "1 to 65535"),
        ("SIM_VIDEO_PORT", "-1", "1 to 65535"),
        ("SIM_CAMERA_FPS", "60", "1 to 30"),
        ("SIM_LOG_LEVEL", "loud", "debug or info"),
    ],
)
def test_wrong_value_names_variable_value_and_allowed(
    variable: str, value: str, allowed: str
) -> None:
    """The error says all three."""
    with pytest.raises(SimSettingsError) as caught:
        from_environment({variable: value})
    for part in (variable, repr(value), allowed):
        assert part in str(caught.value)


def test_typo_is_an_error() -> None:
    with pytest.raises(SimSettingsError, match="SIM_VIDEOPORT"):
        from_environment({"SIM_VIDEOPORT": "1"})


def test_readme_lists_every_variable() -> None:
    readme = Path(sim_robot.__file__).parents[1] / "README.md"
    rows = re.findall(r"^\| `(SIM_\w+)`", readme.read_text(), re.MULTILINE)
    assert rows == list(variable_names())

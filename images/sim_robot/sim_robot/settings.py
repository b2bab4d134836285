"""The simulator's settings: the only module that reads the environment, once, at the start.

Every variable begins with SIM_; one that is not known is an error, since it is most likely a typo.
"""

import socket
from collections.abc import Mapping
from dataclasses import dataclass, fields

from sim_robot.kinematics import DRIVETRAINS

PREFIX = "SIM_"
PORT_MAX = 65535
CAMERA_SIZES = ("640x480", "1280x720")
LOG_LEVELS = ("debug", "info", "warning", "error")


class SimSettingsError(Exception):
    """A variable of the environment has a value that is not allowed."""


@dataclass(frozen=True)
class SimSettings:
    """What is in force. The field `world_size_m` comes from SIM_WORLD_SIZE_M, and so on."""

    name: str
    world_size_m: float = 20.0
    kind: str = "differential"
    ros_version: int = 2
    cameras: int = 3
    bind_address: str = "0.0.0.0"  # noqa: S104  as the real servers do; the network is the container's
    rosbridge_port: int = 9090
    video_port: int = 8080
    camera_fps: float = 15.0
    camera_size: str = "640x480"
    log_level: str = "info"


def from_environment(environment: Mapping[str, str]) -> SimSettings:
    """Read the settings; SimSettingsError names variable, value and what is allowed."""
    values = {key: value for key, value in environment.items() if key.startswith(PREFIX) and value}
    _refuse_unknown(values)
    return SimSettings(
        name=values.get("SIM_NAME") or socket.gethostname(),
        world_size_m=_number(values, "SIM_WORLD_SIZE_M", SimSettings.world_size_m, 2, 1000),
        kind=_one_of(values, "SIM_KIND", SimSettings.kind, tuple(DRIVETRAINS)),
        ros_version=int(
            _one_of(values, "SIM_ROS_VERSION", str(SimSettings.ros_version), ("1", "2"))
        ),
        cameras=int(_one_of(values, "SIM_CAMERAS", str(SimSettings.cameras), ("0", "1", "2", "3"))),
        bind_address=values.get("SIM_BIND_ADDRESS", SimSettings.bind_address),
        rosbridge_port=_port(values, "SIM_ROSBRIDGE_PORT", SimSettings.rosbridge_port),
        video_port=_port(values, "SIM_VIDEO_PORT", SimSettings.video_port),
        camera_fps=_number(values, "SIM_CAMERA_FPS", SimSettings.camera_fps, 1, 30),
        camera_size=_one_of(values, "SIM_CAMERA_SIZE", SimSettings.camera_size, CAMERA_SIZES),
        log_level=_one_of(values, "SIM_LOG_LEVEL", SimSettings.log_level, LOG_LEVELS),
    )


def variable_names() -> tuple[str, ...]:
    """Name every variable that is read."""
    return tuple(PREFIX + field.name.upper() for field in fields(SimSettings))


def _refuse_unknown(values: Mapping[str, str]) -> None:
    for key in sorted(values):
        if key not in variable_names():
            names = ", ".join(variable_names())
            raise SimSettingsError(f"cannot start: {key} is not a setting; known are {names}")


def _wrong(key: str, value: str, allowed: str) -> SimSettingsError:
    return SimSettingsError(f"cannot start: {key} is {value!r}, allowed is {allowed}")


def _number(values: Mapping[str, str], key: str, default: float, low: int, high: int) -> float:
    text = values.get(key, str(default))
    try:
        number = float(text)
    except ValueError as error:
        raise _wrong(key, text, f"a number from {low} to {high}") from error
    if not low <= number <= high:
        raise _wrong(key, text, f"a number from {low} to {high}")
    return number


def _port(values: Mapping[str, str], key: str, default: int) -> int:
    text = values.get(key, str(default))
    if not text.isdecimal() or int(text) > PORT_MAX:
        raise _wrong(key, text, "a port from 1 to 65535, or 0 for any free one")
    return int(text)


def _one_of(values: Mapping[str, str], key: str, default: str, allowed: tuple[str, ...]) -> str:
    text = values.get(key, default)
    if text not in allowed:
        raise _wrong(key, text, " or ".join(allowed))
    return text

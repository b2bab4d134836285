"""What speeds a drive command asks for, and what is none."""

from __future__ import annotations

import json

import pytest
from robotether_server.relay.rosbridge.drive_commands import DriveCommand, speeds, stamped
from robotether_server.relay.rosbridge.fields import FieldRefusedError

TWIST = {"linear": {"x": 3, "y": 4.0, "z": 0}, "angular": {"x": 0, "y": 0, "z": -2}}


@pytest.mark.parametrize(
    ("msg", "speed", "turn"),
    [
        (TWIST, 5.0, 2.0),
        ({"linear": {"x": -1}}, 1.0, 0.0),
        ({"angular": {}}, 0.0, 0.0),
        ({}, 0.0, 0.0),
        ({"header": {"frame_id": "base"}, "twist": TWIST}, 5.0, 2.0),
        ({"header": {}}, 0.0, 0.0),
        ({"drive": {"speed": -1.5, "steering_angle": 0.3}}, 1.5, None),
        ({"header": {}, "drive": {}}, 0.0, None),
    ],
)
def test_each_shape_has_its_speeds(msg, speed, turn):
    """Speed and turn are lengths; what is missing is zero."""
    assert speeds(msg) == (speed, turn)


@pytest.mark.parametrize(
    "msg",
    [
        {"data": 1},
        {"linear": TWIST["linear"], "twist": TWIST},
        {"twist": TWIST, "drive": {}},
        {"twist": {"linear": {}, "header": {}}},
        {"linear": None},
        {"linear": [1, 2, 3]},
        {"linear": {"x": 1, "w": 1}},
        {"linear": {"x": None}},
        {"linear": {"x": True}},
        {"linear": {"x": "1"}},
        {"linear": {"x": float("inf")}},
        {"linear": {"x": 1.7e308, "y": 1.7e308}},
        {"angular": {"z": float("nan")}},
        {"twist": {"angular": {"z": []}}},
        {"drive": {"speed": None}},
        {"drive": {"speed": 1, "steering_angle": "left"}},
        {"drive": {"velocity": 1}},
        {"drive": 1},
    ],
)
def test_what_is_no_command_is_refused(msg):
    """Two shapes at once, unknown members, and anything that is no finite number."""
    with pytest.raises(FieldRefusedError):
        speeds(msg)


def test_a_command_is_stamped_without_writing_it_again():
    """Moment and number stand behind all that was checked."""
    data = json.dumps({"op": "publish", "topic": "/cmd_vel", "msg": TWIST}).encode()
    command = DriveCommand("/cmd_vel", json.loads(data), data, None, 5.0, 2.0)
    written = stamped(command, 123456.7891, 13)
    assert written.endswith(b',"robotether":{"t_ms":123456.789,"fence":13}}')
    assert json.loads(written) == {
        **json.loads(data),
        "robotether": {"t_ms": 123456.789, "fence": 13},
    }

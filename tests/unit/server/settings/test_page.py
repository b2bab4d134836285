"""What a robot's settings may say about its drive page."""

import json

import pytest
from robotether_server.problems import FieldInvalidError
from robotether_server.settings.page import MAX_CAMERAS, Camera, parse

FRONT = {"topic": "/camera/image_raw", "name": "Front", "turned_deg": 180}


def test_a_camera_need_not_say_how_it_is_turned():
    """Most hang as they should; 90.0 is 90."""
    [upright] = parse({"cameras": [{"topic": "/a", "name": "A"}]}).cameras
    assert upright == Camera("/a", "A", 0)
    [turned] = parse({"cameras": [{"topic": "/a", "name": "A", "turned_deg": 90.0}]}).cameras
    assert json.dumps(turned.turned_deg) == "90"


WRONG = {
    "drive_topic": ("cmd_vel", "/cmd_*"),
    "max_speed_m_s": (0,),
    "hold_after_ms": (299, 10_001, 0),
    "cameras": ([FRONT] * (MAX_CAMERAS + 1), [FRONT, FRONT]),
    "cameras.1": ("/camera",),
    "cameras.1.topic": ("/a?b=c",),
    "cameras.1.name": ("",),
    "cameras.1.turned_deg": (45, False),
}


@pytest.mark.parametrize(
    ("path", "value"), [(path, value) for path, values in WRONG.items() for value in values]
)
def test_a_wrong_value_is_named(path, value):
    name, _, inner = path.partition(".")
    member = inner.partition(".")[2]
    if member:
        value = [{**FRONT, member: value}]
    elif inner:
        value = [value]
    with pytest.raises(FieldInvalidError, match=f"cannot use page.{path}: "):
        parse({name: value})


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"quality_min": 81}, "page.quality_min: 81 is over the highest quality, 80"),
        ({"width": 640}, "page.width: give width and height, or neither"),
        ({"camera": []}, "page: 'camera' is not a setting"),
        ({"cameras": [{**FRONT, "quality": 5}]}, "page.cameras.1: 'quality' is not a setting"),
    ],
)
def test_what_does_not_fit_together_is_refused(given, why):
    """A range that is none, half a size, and members that nobody would read."""
    with pytest.raises(FieldInvalidError, match=f"cannot use {why}"):
        parse(given)

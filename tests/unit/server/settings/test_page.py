"""What a robot's settings may say about its drive page."""

import pytest
from robotether_server.problems import FieldInvalidError
from robotether_server.settings.page import MAX_CAMERAS, parse

FRONT = {"topic": "/camera/image_raw", "name": "Front", "turned_deg": 180}


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"hold_after_ms": 299}, "page.hold_after_ms: it must be null or a whole number from 300"),
        ({"cameras": [FRONT] * (MAX_CAMERAS + 1)}, "page.cameras: it must be a list of at most"),
        ({"cameras": [FRONT, FRONT]}, "page.cameras: /camera/image_raw is there twice"),
        ({"cameras": [{**FRONT, "topic": "/a?b=c"}]}, "page.cameras.1.topic: it must be a topic"),
        ({"quality_min": 81}, "page.quality_min: 81 is over the highest quality, 80"),
        ({"width": 640}, "page.width: give width and height, or neither"),
        ({"video": "none", "cameras": [FRONT]}, "page.video: the page has cameras"),
        ({"cameras": [{**FRONT, "quality": 5}]}, "page.cameras.1: 'quality' is not a setting"),
    ],
)
def test_what_does_not_fit_together_is_refused(given, why):
    """A range that is none, half a size, and members that nobody would read."""
    with pytest.raises(FieldInvalidError, match=f"cannot use {why}"):
        parse(given)

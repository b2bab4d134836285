"""A frame carries its timestamp, and a machine reads it back."""

import pytest
from frame_stamp import NoStampError, read_stamp
from PIL import Image
from sim_robot import camera
from sim_robot.kinematics import Pose, Velocity

MOMENT_NS = 1_795_332_801_234_567_891
MOMENT_S = 1_795_332_801.2345


def picture(size: tuple[int, int]) -> Image.Image:
    """A camera's picture of MOMENT_NS."""
    scene = camera.Scene("sim1", 20.0, Pose(9, 9, 1), Velocity(), (), 0.0, MOMENT_NS)
    return camera.draw(scene, size)


def test_every_bit_counts() -> None:
    """Moments a tenth of a millisecond apart differ, and one wrong cell is no other moment."""
    first, second = camera.stamp_bits(MOMENT_NS), camera.stamp_bits(MOMENT_NS + 100_000)
    assert first != second
    assert len(first) == camera.STAMP_COLUMNS * camera.STAMP_ROWS
    image = picture((640, 480))
    assert read_stamp(camera.jpeg(image, 90)) == MOMENT_S
    lit = bool(first[5])
    image.paste("black" if lit else "white", (5 * 20, 456, 6 * 20, 468))
    with pytest.raises(NoStampError):
        read_stamp(camera.jpeg(image, 90))

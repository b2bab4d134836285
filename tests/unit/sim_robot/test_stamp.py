"""A frame carries its timestamp, and a machine reads it back."""

import io

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


@pytest.mark.parametrize("quality", [10, 95])
@pytest.mark.parametrize("size", [(640, 480), (160, 120), (333, 250)])
def test_moment_outlives_jpeg(size: tuple[int, int], quality: int) -> None:
    """Read back from a JPEG to a tenth of a millisecond, whatever its quality and size."""
    assert read_stamp(camera.jpeg(picture(size), quality)) == MOMENT_S


@pytest.mark.parametrize("size", [(320, 240), (417, 311)])
def test_moment_outlives_scaling(size: tuple[int, int]) -> None:
    """A poor JPEG that is shown at its half, or at any other size, still tells its moment."""
    with Image.open(io.BytesIO(camera.jpeg(picture((640, 480)), 20))) as sent:
        shown = sent.resize(size, Image.Resampling.BILINEAR)
    buffer = io.BytesIO()
    shown.save(buffer, "PNG")
    assert read_stamp(buffer.getvalue()) == MOMENT_S


def test_picture_without_a_stamp_is_told_apart() -> None:
    """What is no stamp is an error and no moment; a picture too small for one has none."""
    for image in (Image.new("RGB", (640, 480), "#f4f1e8"), picture((100, 80))):
        with pytest.raises(NoStampError):
            read_stamp(camera.jpeg(image, 90))


def test_every_bit_counts() -> None:
    """Moments a tenth of a millisecond apart differ, and one wrong cell is no other moment."""
    first, second = camera.stamp_bits(MOMENT_NS), camera.stamp_bits(MOMENT_NS + 100_000)
    assert first != second
    assert len(first) == camera.STAMP_COLUMNS * camera.STAMP_ROWS
    image = picture((640, 480))
    lit = bool(first[5])
    image.paste("black" if lit else "white", (5 * 20, 456, 6 * 20, 468))
    with pytest.raises(NoStampError):
        read_stamp(camera.jpeg(image, 90))

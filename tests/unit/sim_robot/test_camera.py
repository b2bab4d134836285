"""The camera shows the world from above."""

import io
import math

import pytest
from PIL import Image, ImageColor
from sim_robot import camera
from sim_robot.kinematics import Pose, Velocity
from sim_robot.world import World


def scene(x: float = 10.0, y: float = 10.0, theta: float = 0.0, path: tuple = ()) -> camera.Scene:
    """A robot in a world of 20 m."""
    return camera.Scene("sim1", 20.0, Pose(x, y, theta), Velocity(), path, 0.0, 0)


def near(image: Image.Image, point: tuple[float, float], colour: str, radius: int = 6) -> bool:
    """Tell whether a colour is close to a pixel."""
    wanted = ImageColor.getrgb(colour)
    x, y = map(round, point)
    around = range(-radius, radius + 1)
    return any(image.getpixel((x + i, y + j)) == wanted for i in around for j in around)


@pytest.mark.parametrize("size", [(640, 480), (320, 240), (200, 400), (16, 16), (1, 1)])
def test_any_size(size: tuple[int, int]) -> None:
    """The picture has the size that was asked for."""
    assert camera.draw(scene(), size).size == size


@pytest.mark.parametrize(("x", "y"), [(3.0, 4.0), (17.0, 4.0), (16.0, 17.0), (10.0, 10.0)])
def test_robot_is_where_it_is(x: float, y: float) -> None:
    """The picture has x to the right and y up."""
    size = (640, 480)
    image = camera.draw(scene(x, y), size)
    scale = 479 / 20
    assert near(image, (80 + x * scale, 479 - y * scale), camera.BODY)
    assert not near(image, (80 + (20 - x) * scale + 40, 479 - y * scale), camera.BODY)


def test_nose_points_along_theta() -> None:
    """With theta pi/2 the nose is above the middle."""
    image = camera.draw(scene(theta=math.pi / 2), (2000, 2000))
    middle, ahead = 999.5, 0.3 * 1999 / 20
    assert near(image, (middle, middle - ahead), camera.NOSE, 2)
    assert not near(image, (middle, middle + ahead), camera.NOSE, 2)


def test_obstacles_are_drawn() -> None:
    """What the scanner finds is seen too."""
    image = camera.draw(scene(), (640, 480))
    for obstacle in World(20.0).obstacles:
        left, lower, right, upper = obstacle.bounds
        x, y = (left + right) / 2, (lower + upper) / 2
        assert near(image, (80 + x * 479 / 20, 479 - y * 479 / 20), camera.OBSTACLE, 1)


def test_path_is_drawn() -> None:
    """The way so far is visible."""
    image = camera.draw(scene(2.0, 2.0, path=((5.0, 5.0), (15.0, 5.0))), (640, 480))
    assert near(image, (80 + 10 * 479 / 20, 479 - 5 * 479 / 20), camera.PATH, 2)


def test_jpeg_has_the_quality_asked_for() -> None:
    """Less quality is fewer bytes, and both are JPEG."""
    image = camera.draw(scene(), (640, 480))
    good, poor = camera.jpeg(image, 90), camera.jpeg(image, 30)
    assert len(poor) < len(good)
    assert Image.open(io.BytesIO(poor)).format == "JPEG"

"""What the robot's own camera sees, as its frames show it."""

import math

import pytest
from PIL import Image
from sim_robot.first_person import draw
from sim_robot.kinematics import Pose
from sim_robot.world import World

WORLD = World(20)
FOCAL_PX = 320 / math.tan(math.radians(35))
# The post that alone is blue below the walls.
POST_X, POST_Y, POST_RADIUS = 17.0, 12.5, 0.8


def red_part(image: Image.Image) -> float:
    """How much of a frame is the eastern wall, which alone is red."""
    red, _, blue = (band.tobytes() for band in image.split())
    return sum(one - other > 25 for one, other in zip(red, blue, strict=True)) / len(red)


def post_columns(image: Image.Image) -> tuple[int, int]:
    """First and last column of the post, in a row that no wall comes down to."""
    red, _, blue = (band.tobytes() for band in image.crop((0, 229, 640, 230)).split())
    columns = [at for at in range(640) if blue[at] - red[at] > 30]
    return columns[0], columns[-1] + 1


def test_wall_ahead_fills_the_frame() -> None:
    """The nearer the robot comes, the more of its frame is wall; at the wall, all of it."""
    parts = [red_part(draw(WORLD, Pose(x, 6, 0), (640, 480))) for x in (2, 14, 17, 18.5, 19.5, 20)]
    assert parts == sorted(parts)
    assert parts[0] < 0.1
    assert parts[-1] > 0.99


@pytest.mark.parametrize("turned_left", [-0.3, 0.0, 0.15, 0.3])
@pytest.mark.parametrize("away", [2.5, 5.0, 7.0])
def test_things_are_in_perspective(away: float, turned_left: float) -> None:
    """Near things are large, and turning left moves them to the right, as a lens of 70 degrees shows them."""
    image = draw(WORLD, Pose(POST_X - away, POST_Y, turned_left), (640, 480))
    half = math.asin(POST_RADIUS / away)
    edges = [320 + FOCAL_PX * math.tan(turned_left + side) for side in (-half, half)]
    seen = [min(max(edge, 0), 640) for edge in edges]
    assert post_columns(image) == pytest.approx(seen, abs=2)


@pytest.mark.parametrize("theta", [-math.pi / 2, 0, math.pi / 2])
def test_floor_is_fixed_to_the_world(theta: float) -> None:
    """Between two rows of slabs their joint of 2 cm runs straight ahead, from the wheels to the wall."""
    floor = draw(WORLD, Pose(10, 10, theta), (640, 480)).convert("L").crop((0, 240, 640, 440))
    parts = floor.resize((640, 4), Image.Resampling.BOX).tobytes()
    for part in range(4):
        columns = parts[part * 640 + 240 : part * 640 + 400]
        assert 240 + columns.index(min(columns)) == pytest.approx(320, abs=14), part


@pytest.mark.parametrize("size", [(640, 480), (333, 250), (1, 1), (2048, 2), (2, 2048)])
@pytest.mark.parametrize("world_m", [2, 20, 1000])
def test_there_is_a_frame_everywhere(world_m: float, size: tuple[int, int]) -> None:
    """Of the wanted size: in corners, beyond a wall, inside an obstacle and just before it."""
    world = World(world_m)
    post = world.obstacles[0]
    left, middle = post.bounds[0], sum(post.bounds[1::2]) / 2
    places = [(0, 0), (world_m, world_m), (world_m / 2, 0), (left - 0.01, middle), (left, middle)]
    for x, y in [*places, (left + 0.02, middle)]:
        for theta in (-math.pi, -0.8, 0, 0.5, 3.1):
            assert draw(world, Pose(x, y, theta), size).size == size

"""What the robot's own camera sees."""

import math

import pytest
from sim_robot.first_person import draw
from sim_robot.kinematics import Pose
from sim_robot.world import World


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

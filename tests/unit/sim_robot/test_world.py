"""The world is measured by rays and mapped in cells, and both agree."""

import math

import pytest
from sim_robot.kinematics import STEP_S, Turtle, Velocity
from sim_robot.world import FREE, UNKNOWN, WALL, Box, Round, World


def test_walls_are_where_they_are() -> None:
    """From the middle of an empty side the wall ahead is half the world away, the corner further."""
    world = World(20.0)
    assert world.distance(10.0, 10.0, -math.pi / 2) == pytest.approx(10.0)
    assert world.distance(10.0, 10.0, -3 * math.pi / 4) == pytest.approx(10.0 * math.sqrt(2))


def test_round_obstacle_is_hit_at_its_edge() -> None:
    """A ray through the middle ends a radius before it; one beside or behind misses."""
    pillar = Round(5.0, 0.0, 1.0)
    assert pillar.distance(0.0, 0.0, 1.0, 0.0) == pytest.approx(4.0)
    assert pillar.distance(0.0, 1.1, 1.0, 0.0) == math.inf
    assert pillar.distance(0.0, 0.0, -1.0, 0.0) == math.inf
    assert pillar.distance(5.2, 0.0, 1.0, 0.0) == 0.0


def test_box_is_hit_at_its_edge() -> None:
    """A ray along an axis and one aslant end at the edge; one beside or behind misses."""
    box = Box(4.0, -1.0, 6.0, 1.0)
    assert box.distance(0.0, 0.0, 1.0, 0.0) == pytest.approx(4.0)
    assert box.distance(0.0, 4.0, math.cos(-math.pi / 4), math.sin(-math.pi / 4)) == pytest.approx(
        4 * math.sqrt(2)
    )
    assert box.distance(0.0, 1.5, 1.0, 0.0) == math.inf
    assert box.distance(0.0, 0.0, -1.0, 0.0) == math.inf
    assert box.distance(5.0, 0.0, 0.0, 1.0) == 0.0


@pytest.mark.parametrize("size_m", [2.0, 20.0, 300.0])
def test_a_ray_ends_where_the_map_has_something(size_m: float) -> None:
    """The cell just behind the end of each ray is not free, but for a cell's width of doubt."""
    world, cells = World(size_m), 200
    grid, step = world.grid(cells), size_m / cells
    for number in range(90):
        angle = number * 2 * math.pi / 90
        far = world.distance(size_m / 2, size_m / 2, angle)
        ends = [
            (size_m / 2 + math.cos(angle) * way, size_m / 2 + math.sin(angle) * way)
            for way in (far - step, far, far + step)
        ]
        found = {
            grid[min(int(y / step), cells - 1) * cells + min(int(x / step), cells - 1)]
            for x, y in ends
            if x >= 0 and y >= 0
        }
        assert found & {WALL, UNKNOWN}, (angle, far)


def test_map_has_all_three_kinds_of_cells() -> None:
    """Free, occupied and unknown, walls all around, and as many as were asked for."""
    grid = World(20.0).grid(50)
    assert set(grid) == {FREE, WALL, UNKNOWN}
    assert len(grid) == 50 * 50
    assert grid[:50] == grid[-50:] == [WALL] * 50


def test_the_papers_spiral_meets_no_obstacle() -> None:
    """The open-loop spiral passes every obstacle by more than the robot's radius."""
    turtle, world = Turtle(20.0), World(20.0)
    for message in range(62):
        for _ in range(31 if message % 4 else 32):
            turtle.command(Velocity(1.0 + 0.05 * message, 0.0, 1.0), 0.0)
            turtle.step(0.0 + STEP_S)
            around = (
                (turtle.pose.x + 0.4 * math.cos(a), turtle.pose.y + 0.4 * math.sin(a))
                for a in range(7)
            )
            assert not any(item.holds(*place) for item in world.obstacles for place in around)

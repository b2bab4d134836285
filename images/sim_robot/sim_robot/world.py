"""What stands in the simulated robot's world: its walls and some obstacles, for the eye, the scanner and the map.

Used by camera.py and devices.py. Frame: that of kinematics.py, metres. Obstacles are seen and never felt: the robot
drives through them. They stand where the paper's spiral does not come.
"""

import math
from dataclasses import dataclass

FREE, WALL, UNKNOWN = 0, 100, -1  # as nav_msgs/OccupancyGrid writes them


@dataclass(frozen=True, slots=True)
class RoundObstacle:
    """A round obstacle."""

    x: float
    y: float
    radius: float

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Give left, lower, right and upper edge."""
        return (
            self.x - self.radius,
            self.y - self.radius,
            self.x + self.radius,
            self.y + self.radius,
        )

    def holds(self, x: float, y: float) -> bool:
        """Tell whether a point is inside."""
        return math.hypot(x - self.x, y - self.y) <= self.radius

    def distance(self, x: float, y: float, cos: float, sin: float) -> float:
        """Measure along a ray; infinite if it misses."""
        away_x, away_y = self.x - x, self.y - y
        along = away_x * cos + away_y * sin
        room = self.radius**2 - (away_x**2 + away_y**2 - along**2)
        if room < 0 or along + math.sqrt(room) < 0:
            return math.inf
        return max(along - math.sqrt(room), 0.0)


@dataclass(frozen=True, slots=True)
class Box:
    """An obstacle with edges along the axes."""

    left: float
    lower: float
    right: float
    upper: float

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Give left, lower, right and upper edge."""
        return self.left, self.lower, self.right, self.upper

    def holds(self, x: float, y: float) -> bool:
        """Tell whether a point is inside."""
        return self.left <= x <= self.right and self.lower <= y <= self.upper

    def distance(self, x: float, y: float, cos: float, sin: float) -> float:
        """Measure along a ray; infinite if it misses."""
        in_x, out_x = _crossing(self.left - x, self.right - x, cos)
        in_y, out_y = _crossing(self.lower - y, self.upper - y, sin)
        enters, leaves = max(in_x, in_y), min(out_x, out_y)
        return max(enters, 0.0) if enters <= leaves and leaves >= 0 else math.inf


Obstacle = RoundObstacle | Box


def _crossing(low: float, high: float, speed: float) -> tuple[float, float]:
    """Give when a ray enters and leaves the strip from low to high."""
    if speed == 0:
        return (-math.inf, math.inf) if low <= 0 <= high else (math.inf, -math.inf)
    first, second = low / speed, high / speed
    return min(first, second), max(first, second)


class World:
    """A square with walls, `size_m` long."""

    def __init__(self, size_m: float) -> None:
        self.size_m = size_m
        at = size_m / 20  # the places below are those in a world of 20 m
        self.obstacles: tuple[Obstacle, ...] = (
            RoundObstacle(3.0 * at, 4.5 * at, 0.7 * at),
            RoundObstacle(16.5 * at, 3.0 * at, 0.5 * at),
            RoundObstacle(17.0 * at, 12.5 * at, 0.8 * at),
            Box(2.0 * at, 14.0 * at, 2.4 * at, 18.0 * at),
            Box(12.0 * at, 17.0 * at, 15.0 * at, 18.0 * at),
        )

    def distance(self, x: float, y: float, angle: float) -> float:
        """Measure from a point to the next obstacle or wall, in m."""
        cos, sin = math.cos(angle), math.sin(angle)
        _, wall_x = _crossing(-x, self.size_m - x, cos)
        _, wall_y = _crossing(-y, self.size_m - y, sin)
        return min(wall_x, wall_y, *(item.distance(x, y, cos, sin) for item in self.obstacles))

    def grid(self, cells: int) -> list[int]:
        """Map it in cells x cells, row by row from the lower left; a corner is not known."""
        rows = [[FREE] * cells for _ in range(cells)]
        step = self.size_m / cells
        for obstacle in self.obstacles:
            left, lower, right, upper = (int(edge / step) for edge in obstacle.bounds)
            for row in range(lower, min(upper + 1, cells)):
                for column in range(left, min(right + 1, cells)):
                    if obstacle.holds((column + 0.5) * step, (row + 0.5) * step):
                        rows[row][column] = WALL
        corner = cells // 8
        for line in rows[-corner:]:
            line[-corner:] = [UNKNOWN] * corner
        for line in rows:
            line[0] = line[-1] = WALL
        rows[0] = rows[-1] = [WALL] * cells
        return [cell for row in rows for cell in row]

"""Draws what a camera on the robot sees: sky and hills, a floor of slabs, the walls and the obstacles.

Used by camera.py. The floor is a texture in perspective; all else are polygons, cut off before the lens, projected and
painted from far to near. The camera is level, so that what stands upright stays so.
"""

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache

from PIL import Image, ImageChops, ImageDraw, ImageOps

from sim_robot.kinematics import Pose
from sim_robot.world import Box, Obstacle, RoundObstacle, World

Size = tuple[int, int]
Colour = tuple[int, int, int]
Point = tuple[float, float]
Corner = tuple[float, float, float]  # forward, to the right and up from the camera
Band = tuple[float, float, Colour]  # of something upright: from and to a height, in a colour

CAMERA_HEIGHT_M = 0.3
SLOPE = math.tan(math.radians(35))  # of the frame's left and right edge: it shows 70 degrees
HORIZON_PART = 0.44  # of the frame's height: the lens is shifted down to the floor
BUMPER_M = 0.2  # the camera comes no nearer to a wall
NEAR_M = 0.04
BLACK, WHITE, HAZE = (0, 0, 0), (255, 255, 255), (204, 212, 214)
HAZE_M = 60.0  # where it has taken 63 % of a colour
SKY_LOW, SKY_HIGH = (218, 230, 236), (92, 142, 196)
HILLS: tuple[tuple[Colour, float, tuple[int, ...]], ...] = (
    ((170, 188, 202), 0.17, (3, 5, 11)),
    ((132, 156, 144), 0.13, (2, 7, 17)),
)
HILL_STEP_RAD = math.radians(2)
WALL_M, PANEL_M, PANELS_MAX = 1.4, 1.0, 24
COURSE_M, COURSES_SEEN_M, MORTAR_M = 0.2, 4.0, 0.012
WALLS: tuple[Colour, ...] = (
    (184, 104, 78),  # east
    (94, 132, 164),  # north
    (196, 168, 104),  # west
    (112, 146, 104),  # south
)
PAINTS: tuple[tuple[Colour, Colour, float], ...] = (
    # of each obstacle of the world: its colour, that of its stripe or edges, its height in m
    ((206, 66, 48), (238, 234, 222), 1.1),
    ((232, 176, 40), (52, 50, 48), 0.9),
    ((66, 108, 172), (226, 232, 236), 1.5),
    ((160, 116, 74), (104, 72, 44), 1.0),
    ((84, 150, 110), (52, 98, 72), 1.2),
)
STRIPS, PLANK_M = 12, 0.5  # of the visible half of a post; of a box
LIGHT_RAD = math.radians(240)  # where the light comes from
SHADOW, SHADOW_M, SHADOW_CORNERS = (84, 83, 82), 0.35, 16
FLOOR, MORTAR, FLOOR_DARK, FLOOR_LIGHT = 150, 90, (58, 56, 52), (232, 228, 216)
NOISES = ((3, 9), (16, 9), (64, 19))  # of the floor: spots a metre, and how strong
SLABS_M = 4  # a slab is 1 m, and after so much they are the same again
TEXELS_M = 160  # texels a metre in the nearest part of the floor
# Parts of the floor: its distance, the number of texels per sample (else distant ones would glitter), and the number of
# pixels per look-up, where a texel is large anyway.
FLOOR_PARTS = ((1.4, 1, 2), (2.6, 2, 1), (6.0, 5, 1), (30.0, 20, 1))


class Lens:
    """Where the camera stands and looks, and how large its frame is."""

    def __init__(self, pose: Pose, world_m: float, size: Size) -> None:
        self.x = min(max(pose.x, BUMPER_M), world_m - BUMPER_M)
        self.y = min(max(pose.y, BUMPER_M), world_m - BUMPER_M)
        self.theta = pose.theta
        self.cos, self.sin = math.cos(pose.theta), math.sin(pose.theta)
        self.size = size
        self.middle, self.horizon = size[0] / 2, size[1] * HORIZON_PART
        self.focal = self.middle / SLOPE

    def position(self, x: float, y: float) -> Point:
        """Find a point on the floor: how far it is, and how far to the right."""
        x, y = x - self.x, y - self.y
        return x * self.cos + y * self.sin, x * self.sin - y * self.cos

    def sees(self, positions: Sequence[Point]) -> bool:
        """Tell whether what is between these positions may be in the frame."""
        return (
            any(far > NEAR_M for far, _ in positions)
            and any(right > -far * SLOPE for far, right in positions)
            and any(right < far * SLOPE for far, right in positions)
        )

    def project(self, corners: Sequence[Corner]) -> list[Point]:
        """Find the pixels of a polygon's part before the camera."""
        if any(corner[0] < NEAR_M for corner in corners):
            corners = list(_before_the_lens(corners))
        focal, middle, horizon = self.focal, self.middle, self.horizon
        return [
            (middle + focal * right / far, horizon - focal * up / far) for far, right, up in corners
        ]


def _before_the_lens(corners: Sequence[Corner]) -> Iterator[Corner]:
    for last, corner in zip([corners[-1], *corners[:-1]], corners, strict=True):
        if (last[0] < NEAR_M) != (corner[0] < NEAR_M):
            part = (NEAR_M - last[0]) / (corner[0] - last[0])
            right, up = (last[axis] + part * (corner[axis] - last[axis]) for axis in (1, 2))
            yield NEAR_M, right, up
        if corner[0] >= NEAR_M:
            yield corner


class Painter:
    """Fills polygons of the world in a frame."""

    def __init__(self, image: Image.Image, lens: Lens) -> None:
        self.lens = lens
        self._canvas = ImageDraw.Draw(image)

    def ground(self, points: Sequence[Point], colour: Colour) -> None:
        """Fill a polygon on the floor."""
        self._fill([(*self.lens.position(*point), -CAMERA_HEIGHT_M) for point in points], colour)

    def upright(self, start: Point, end: Point, bands: Sequence[Band]) -> None:
        """Fill rectangles over a line on the floor, the later ones over the earlier."""
        left, right = self.lens.position(*start), self.lens.position(*end)
        if not self.lens.sees((left, right)):
            return
        distance_m = round(math.hypot(left[0] + right[0], left[1] + right[1]) / 2)
        for low, high, colour in bands:
            bottom, top = low - CAMERA_HEIGHT_M, high - CAMERA_HEIGHT_M
            corners = [(*left, bottom), (*right, bottom), (*right, top), (*left, top)]
            self._fill(corners, _hazy(colour, distance_m))

    def _fill(self, corners: Sequence[Corner], colour: Colour) -> None:
        points = self.lens.project(corners)
        if points:
            self._canvas.polygon(points, colour)


def draw(world: World, pose: Pose, size: Size) -> Image.Image:
    """Draw one frame."""
    lens = Lens(pose, world.size_m, size)
    image = _background(size).copy()
    _draw_hills(ImageDraw.Draw(image), lens)
    _draw_floor(image, lens)
    painter = Painter(image, lens)
    _draw_walls(painter, world.size_m)
    _draw_obstacles(painter, world)
    return image


@lru_cache(maxsize=1024)
def _mixed(colour: Colour, other: Colour, part: float) -> Colour:
    red, green, blue = (
        round(level + (target - level) * part) for level, target in zip(colour, other, strict=True)
    )
    return red, green, blue


@lru_cache(maxsize=1024)
def _hazy(colour: Colour, distance_m: float) -> Colour:
    return _mixed(colour, HAZE, 1 - math.exp(-distance_m / HAZE_M))


@lru_cache(maxsize=8)
def _background(size: Size) -> Image.Image:
    horizon = size[1] * HORIZON_PART
    column = Image.new("RGB", (1, size[1]), _hazy((FLOOR, FLOOR, FLOOR), FLOOR_PARTS[-1][0]))
    for row in range(math.ceil(horizon)):
        column.putpixel((0, row), _mixed(SKY_HIGH, SKY_LOW, row / horizon))
    return column.resize(size)


def _draw_hills(canvas: ImageDraw.ImageDraw, lens: Lens) -> None:
    ahead = round(lens.theta / HILL_STEP_RAD)
    beside = math.ceil(math.atan(SLOPE) / HILL_STEP_RAD) + 1
    # They are so far away that only the heading counts.
    steps = range(ahead - beside, ahead + beside + 1)
    turns = [lens.theta - step * HILL_STEP_RAD for step in steps]
    across = [lens.middle + lens.focal * math.tan(turn) for turn in turns]
    for number, (colour, _, _) in enumerate(HILLS):
        ups = [
            _hill(number, step) / math.cos(turn) for step, turn in zip(steps, turns, strict=True)
        ]
        line = [(u, lens.horizon - lens.focal * up) for u, up in zip(across, ups, strict=True)]
        canvas.polygon([(across[0], lens.horizon), *line, (across[-1], lens.horizon)], colour)


@lru_cache(maxsize=1024)
def _hill(number: int, step: int) -> float:
    _, high, waves = HILLS[number]
    return high * (1 + sum(math.sin(wave * (step * HILL_STEP_RAD + 1)) for wave in waves) / 5)


def _draw_floor(image: Image.Image, lens: Lens) -> None:
    lower = lens.size[1]
    for end_m, texel, pixels in FLOOR_PARTS:
        upper = min(math.ceil(lens.horizon + lens.focal * CAMERA_HEIGHT_M / end_m), lower)
        if upper < lower:
            radius_m = math.ceil(end_m * math.hypot(1, SLOPE))
            size = (-(-lens.size[0] // pixels), -(-(lower - upper) // pixels))
            part = _floor_texture(end_m, texel, radius_m).transform(
                size,
                Image.Transform.PERSPECTIVE,
                _perspective(lens, upper, radius_m, TEXELS_M / texel, pixels),
            )
            image.paste(
                part.resize((size[0] * pixels, size[1] * pixels), Image.Resampling.NEAREST),
                (0, upper),
            )
        lower = upper


def _perspective(
    lens: Lens, upper: int, radius_m: int, texels_m: float, pixels: int
) -> Sequence[float]:
    """Find which texel is at a pixel (u, v): it sees what is CAMERA_HEIGHT_M * focal / (v - horizon) away."""
    below, high = upper - lens.horizon, CAMERA_HEIGHT_M
    scale, step = texels_m / below, texels_m / below * pixels
    x, y = lens.x % SLABS_M + radius_m, lens.y % SLABS_M + radius_m
    x_start = x * below + high * (lens.focal * lens.cos - lens.middle * lens.sin)
    y_start = y * below + high * (lens.focal * lens.sin + lens.middle * lens.cos)
    return (
        *(step * high * lens.sin, step * x, scale * x_start),
        *(-step * high * lens.cos, step * y, scale * y_start),
        *(0, pixels / below),
    )


@lru_cache(maxsize=len(FLOOR_PARTS))
def _floor_texture(end_m: float, texel: int, radius_m: int) -> Image.Image:
    """Lay slabs as far as the camera sees from anywhere in the first SLABS_M metres."""
    slabs = _slabs().reduce(texel)
    slabs = Image.blend(
        slabs, Image.new("RGB", slabs.size, HAZE), 1 - math.exp(-end_m / 2 / HAZE_M)
    )
    side = (SLABS_M + 2 * radius_m) * TEXELS_M // texel
    texture = Image.new("RGB", (side, side))
    first = radius_m * TEXELS_M // texel % slabs.width - slabs.width
    for left in range(first, side, slabs.width):
        for top in range(first, side, slabs.height):
            texture.paste(slabs, (left, top))
    return texture


@lru_cache(maxsize=1)
def _slabs() -> Image.Image:
    size = (SLABS_M * TEXELS_M, SLABS_M * TEXELS_M)
    tones = Image.new("L", size, MORTAR)
    for number in range(SLABS_M**2):
        x, y = number % SLABS_M * TEXELS_M, number // SLABS_M * TEXELS_M
        tone = FLOOR - 24 + (number * 7 + number // SLABS_M * 5) % 16 * 3
        tones.paste(tone, (x + 3, y + 3, x + TEXELS_M, y + TEXELS_M))
    for spots, strength in NOISES:
        noise = Image.effect_noise((SLABS_M * spots, SLABS_M * spots), strength)
        tones = ImageChops.add(tones, noise.resize(size, Image.Resampling.BICUBIC), offset=-128)
    return ImageOps.colorize(tones, FLOOR_DARK, FLOOR_LIGHT)


def _draw_walls(painter: Painter, size_m: float) -> None:
    corners = ((size_m, 0.0), (size_m, size_m), (0.0, size_m), (0.0, 0.0))
    count = min(max(round(size_m / PANEL_M), 1), PANELS_MAX)
    for number, colour in enumerate(WALLS):
        start, end = corners[number], corners[(number + 1) % len(corners)]
        if not painter.lens.sees((painter.lens.position(*start), painter.lens.position(*end))):
            continue
        for panel in range(count):
            _draw_panel(
                painter,
                _between(start, end, panel / count),
                _between(start, end, (panel + 1) / count),
                _mixed(colour, BLACK, 0.1 * (panel % 2) + 0.08 * (number % 2)),
            )


def _draw_panel(painter: Painter, start: Point, end: Point, colour: Colour) -> None:
    bands = [
        (0.1, WALL_M - 0.1, colour),
        (0.0, 0.1, _mixed(colour, BLACK, 0.45)),
        (WALL_M - 0.1, WALL_M, _mixed(colour, WHITE, 0.45)),
    ]
    if math.dist(start, (painter.lens.x, painter.lens.y)) < COURSES_SEEN_M:
        mortar = _mixed(colour, BLACK, 0.2)
        courses = (course * COURSE_M for course in range(1, int(WALL_M / COURSE_M)))
        bands += [(course - MORTAR_M, course, mortar) for course in courses]
    painter.upright(start, end, bands)


def _between(start: Point, end: Point, part: float) -> Point:
    return start[0] + (end[0] - start[0]) * part, start[1] + (end[1] - start[1]) * part


def _draw_obstacles(painter: Painter, world: World) -> None:
    lens = painter.lens
    seen = [
        (obstacle, paint)
        for obstacle, paint in zip(world.obstacles, PAINTS, strict=True)
        if lens.sees([lens.position(*point) for point in _shadow(obstacle)])
    ]
    for obstacle, _ in seen:
        painter.ground(_shadow(obstacle), SHADOW)
    seen.sort(key=lambda pair: -_distance(pair[0], lens.x, lens.y))
    for obstacle, (colour, stripe, high) in seen:
        if isinstance(obstacle, Box):
            _draw_box(painter, obstacle, colour, stripe, high)
        else:
            _draw_post(painter, obstacle, colour, stripe, high)


def _distance(obstacle: Obstacle, x: float, y: float) -> float:
    left, lower, right, upper = obstacle.bounds
    return math.hypot(max(left - x, 0, x - right), max(lower - y, 0, y - upper))


@lru_cache(maxsize=len(PAINTS))
def _shadow(obstacle: Obstacle) -> list[Point]:
    """Find the outline of a shadow, round as its obstacle, and around all of it."""
    left, lower, right, upper = obstacle.bounds
    x = (left + right - SHADOW_M * math.cos(LIGHT_RAD)) / 2
    y = (lower + upper - SHADOW_M * math.sin(LIGHT_RAD)) / 2
    wide, deep = (right - left + SHADOW_M) / 2, (upper - lower + SHADOW_M) / 2
    roundness = 0.3 if isinstance(obstacle, Box) else 0.9

    def bent(value: float) -> float:
        return math.copysign(abs(value) ** roundness, value)

    angles = [2 * math.pi * (number + 0.5) / SHADOW_CORNERS for number in range(SHADOW_CORNERS)]
    return [
        (x + wide * bent(math.cos(angle)), y + deep * bent(math.sin(angle))) for angle in angles
    ]


def _lit(colour: Colour, facing_rad: float) -> Colour:
    return _mixed(colour, BLACK, round(0.28 - 0.28 * math.cos(facing_rad - LIGHT_RAD), 2))


def _draw_post(
    painter: Painter, post: RoundObstacle, colour: Colour, stripe: Colour, high: float
) -> None:
    x, y = painter.lens.x - post.x, painter.lens.y - post.y
    distance = math.hypot(x, y)
    if distance < post.radius + 2 * NEAR_M:
        return  # the robot drives through, and sees out of it
    towards, half = math.atan2(y, x), math.acos(post.radius / distance)
    angles = [towards + half * (2 * number / STRIPS - 1) for number in range(STRIPS + 1)]
    around = [
        (post.x + post.radius * math.cos(angle), post.y + post.radius * math.sin(angle))
        for angle in angles
    ]
    for number in range(STRIPS):
        facing = (angles[number] + angles[number + 1]) / 2
        bands = ((0.0, high, _lit(colour, facing)), (high * 0.4, high * 0.65, _lit(stripe, facing)))
        painter.upright(around[number], around[number + 1], bands)


def _draw_box(painter: Painter, box: Box, colour: Colour, edges: Colour, high: float) -> None:
    x, y = painter.lens.x, painter.lens.y
    left, lower, right, upper = box.bounds
    faces = (
        (x > right, (right, lower), (right, upper), 0.0),
        (y > upper, (right, upper), (left, upper), math.pi / 2),
        (x < left, (left, upper), (left, lower), math.pi),
        (y < lower, (left, lower), (right, lower), -math.pi / 2),
    )
    for is_seen, start, end, facing in faces:
        if is_seen:
            painter.upright(start, end, ((0.0, high, _lit(edges, facing)),))
            count = max(round(math.dist(start, end) / PLANK_M), 1)
            for plank in range(count):
                shade = _lit(_mixed(colour, BLACK, plank % 3 * 0.06), facing)
                painter.upright(
                    _between(start, end, (plank + 0.04) / count),
                    _between(start, end, (plank + 0.96) / count),
                    ((0.06, high - 0.06, shade),),
                )

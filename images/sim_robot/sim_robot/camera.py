"""Draws the simulated robot's world from above: the picture behind /camera/image_raw.

Called by frames.py in a thread; it gets everything in a Scene and touches nothing else. What is drawn is
the list LAYERS, from bottom to top.
"""

import io
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache

from PIL import Image, ImageDraw, ImageFont

from sim_robot import stamp
from sim_robot.kinematics import Pose, Velocity
from sim_robot.world import Box, World

Size = tuple[int, int]
Point = tuple[float, float]

GRID, GRID_STRONG, WALL, OBSTACLE = "#ddd8c8", "#c4bda6", "#6b6450", "#a89f86"
GROUNDS = {"front": "#f4f1e8", "rear": "#dfe9f1"}  # so that a person tells the cameras apart
PATH, BODY, NOSE, TEXT, TEXT_GROUND = "#2f6fb0", "#c8502e", "#ffffff", "#20201c", "#fffdf6"
ROBOT_RADIUS_M, ROBOT_RADIUS_MIN_PX = 0.4, 9
GRID_LINES_MAX, GRID_STRONG_EVERY, LABEL_PX = 40, 5, 11
BACKGROUNDS = 8


@dataclass(frozen=True, slots=True)
class Scene:
    """What the camera sees at one moment; `stamp_ns` is that moment in Unix time."""

    name: str
    world_size_m: float
    pose: Pose
    velocity: Velocity
    path: tuple[Point, ...]
    sim_time_s: float
    stamp_ns: int
    camera: str = "front"


@dataclass(frozen=True, slots=True)
class View:
    """Where the world lies in a picture: all of it, square, in the middle."""

    size: Size
    world_size_m: float

    @property
    def scale(self) -> float:
        """Pixels a metre."""
        return (min(self.size) - 1) / self.world_size_m

    def pixels(self, points: Iterable[Point]) -> list[Point]:
        """Find points of the world; y goes up in the world and down in the picture."""
        scale = self.scale
        left = (self.size[0] - 1 - scale * self.world_size_m) / 2
        bottom = (self.size[1] - 1 + scale * self.world_size_m) / 2
        return [(left + x * scale, bottom - y * scale) for x, y in points]


def draw(scene: Scene, size: Size) -> Image.Image:
    """Draw one picture, with its moment along the lower edge (stamp.py)."""
    view = View(size, scene.world_size_m)
    image = _background(view, GROUNDS[scene.camera]).copy()
    canvas = ImageDraw.Draw(image)
    for layer in LAYERS:
        layer(canvas, view, scene)
    stamp.put(image, scene.stamp_ns)
    return image


def jpeg(image: Image.Image, quality: int) -> bytes:
    """Encode a picture; quality from 1 to 100."""
    buffer = io.BytesIO()
    image.save(buffer, "JPEG", quality=quality)
    return buffer.getvalue()


@lru_cache(maxsize=BACKGROUNDS)
def _background(view: View, ground: str) -> Image.Image:
    image = Image.new("RGB", view.size, ground)
    canvas = ImageDraw.Draw(image)
    end_m = view.world_size_m
    step_m = max(1, math.ceil(end_m / GRID_LINES_MAX))
    for line in range(math.floor(end_m / step_m) + 1):
        at_m = line * step_m
        colour = GRID if line % GRID_STRONG_EVERY else GRID_STRONG
        canvas.line(view.pixels([(at_m, 0), (at_m, end_m)]), colour)
        canvas.line(view.pixels([(0, at_m), (end_m, at_m)]), colour)
        if line % GRID_STRONG_EVERY == 0:
            ((x, y),) = view.pixels([(at_m, 0)])
            canvas.text((x + LABEL_PX // 3, y - LABEL_PX * 1.4), f"{at_m} m", WALL, _font(LABEL_PX))
    for obstacle in World(end_m).obstacles:
        left, lower, right, upper = obstacle.bounds
        draw_shape = canvas.rectangle if isinstance(obstacle, Box) else canvas.ellipse
        draw_shape(view.pixels([(left, upper), (right, lower)]), fill=OBSTACLE)
    canvas.rectangle(view.pixels([(0, end_m), (end_m, 0)]), outline=WALL, width=2)
    return image


def _draw_path(canvas: ImageDraw.ImageDraw, view: View, scene: Scene) -> None:
    if len(scene.path) > 1:
        canvas.line(view.pixels(scene.path), PATH, width=2)


def _draw_robot(canvas: ImageDraw.ImageDraw, view: View, scene: Scene) -> None:
    ((x, y),) = view.pixels([(scene.pose.x, scene.pose.y)])
    radius = max(ROBOT_RADIUS_M * view.scale, ROBOT_RADIUS_MIN_PX)
    canvas.ellipse([x - radius, y - radius, x + radius, y + radius], fill=BODY, outline=TEXT)

    def around(angle: float, part: float) -> Point:
        heading = scene.pose.theta + angle
        return x + math.cos(heading) * radius * part, y - math.sin(heading) * radius * part

    canvas.polygon(
        [around(0, 0.95), around(2.4, 0.75), around(math.pi, 0.3), around(-2.4, 0.75)], NOSE
    )


def _draw_caption(canvas: ImageDraw.ImageDraw, view: View, scene: Scene) -> None:
    height = max(10, view.size[1] // 34)
    pose, speed = scene.pose, scene.velocity
    text = (
        f"{scene.name} {scene.camera} (simulated)   t {scene.sim_time_s:.1f} s\n"
        f"x {pose.x:.2f}  y {pose.y:.2f} m   {math.degrees(pose.theta):.0f}\N{DEGREE SIGN}\n"
        f"{speed.linear_x:+.2f} m/s   {speed.angular_z:+.2f} rad/s"
    )
    font = _font(height)
    corner = (height // 2, height // 2)
    left, top, right, bottom = canvas.multiline_textbbox(corner, text, font)
    edge = height // 3
    canvas.rectangle([left - edge, top - edge, right + edge, bottom + edge], fill=TEXT_GROUND)
    canvas.multiline_text(corner, text, TEXT, font)


@lru_cache(maxsize=BACKGROUNDS)
def _font(height: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(height)


Layer = Callable[[ImageDraw.ImageDraw, View, Scene], None]
LAYERS: tuple[Layer, ...] = (_draw_path, _draw_robot, _draw_caption)

"""Draws what the simulated robot's cameras see, and gives the newest frame to whoever asks.

Used by video_server.py, and by `CompressedCamera` for a topic. first_person.py draws what the front camera sees, and
the one that turns; the view from above is the list LAYERS, from bottom to top. All viewers who want the same size and
quality share one drawing. It happens in one thread beside the robot's loop, only when somebody wants it, and never more
often than the camera's rate. That thread gets everything in a Scene and touches nothing else.
"""

import asyncio
import base64
import binascii
import io
import math
from collections import OrderedDict
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache

from PIL import Image, ImageChops, ImageDraw, ImageFont

from sim_robot import first_person
from sim_robot.first_person import PAINTS, WALLS, Point, Size
from sim_robot.graph import Graph, Node
from sim_robot.kinematics import Pose, Velocity
from sim_robot.world import Box, World

AHEAD, ABOVE, AROUND = "front", "above", "turret"  # the cameras
GROUND, GRID, GRID_STRONG, LABEL = "#f4f1e8", "#ddd8c8", "#c4bda6", "#6b6450"
PATH, BODY, NOSE, TEXT, TEXT_GROUND = "#2f6fb0", "#c8502e", "#ffffff", "#20201c", "#fffdf6"
ROBOT_RADIUS_M, ROBOT_RADIUS_MIN_PX = 0.4, 9
GRID_LINES_MAX, GRID_STRONG_EVERY, LABEL_PX = 40, 5, 11
BACKGROUNDS = 8
# Of the camera that turns, and of its noise, a standard deviation of levels: nothing in its frames stays as it was.
TURN_RAD_S, NOISE = 1.5, 10
NOISE_SPARE_PX = 64
STAMP_COLUMNS, STAMP_ROWS = 32, 2
STAMP_ROW_PART = 1 / 40  # of the picture's height
SMALLEST_STAMPED = (128, 96)
STAMP_BYTES = 6
_NS_A_TENTH_MS = 100_000
_NS_PER_S = 1_000_000_000
_CRC_BEGIN = 0xFFFF
MAX_FORMATS = 8
NODE = Node("/camera")


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
    camera: str = AHEAD


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
    """Draw one picture, with its moment along the lower edge."""
    if scene.camera == ABOVE:
        image = _draw_from_above(scene, View(size, scene.world_size_m))
    else:
        image = _draw_from_robot(scene, size)
        _put_caption(image, f"{scene.name} {scene.camera} (simulated)")
    _put_stamp(image, scene.stamp_ns)
    return image


def _draw_from_robot(scene: Scene, size: Size) -> Image.Image:
    world = World(scene.world_size_m)
    if scene.camera == AHEAD:
        return first_person.draw(world, scene.pose, size)
    turned = scene.pose.theta + scene.stamp_ns / _NS_PER_S * TURN_RAD_S % math.tau
    image = first_person.draw(world, replace(scene.pose, theta=turned), size)
    left, top = (scene.stamp_ns // prime % NOISE_SPARE_PX for prime in (1_000_003, 1_299_709))
    noise = _noise(size).crop((left, top, left + size[0], top + size[1]))
    return ImageChops.add(image, noise, offset=-128)


@lru_cache(maxsize=2)
def _noise(size: Size) -> Image.Image:
    """Draw a sensor's noise, larger than the frame: each frame cuts out another part of it."""
    width, height = size
    noise = Image.effect_noise((width + NOISE_SPARE_PX, height + NOISE_SPARE_PX), NOISE)
    return Image.merge("RGB", (noise, noise, noise))


def _draw_from_above(scene: Scene, view: View) -> Image.Image:
    image = _background(view).copy()
    canvas = ImageDraw.Draw(image)
    for layer in LAYERS:
        layer(canvas, view, scene)
    pose, speed = scene.pose, scene.velocity
    _put_caption(
        image,
        f"{scene.name} {scene.camera} (simulated)   t {scene.sim_time_s:.1f} s\n"
        f"x {pose.x:.2f}  y {pose.y:.2f} m   {math.degrees(pose.theta):.0f}\N{DEGREE SIGN}\n"
        f"{speed.linear_x:+.2f} m/s   {speed.angular_z:+.2f} rad/s",
    )
    return image


def jpeg(image: Image.Image, quality: int) -> bytes:
    """Encode a picture; quality from 1 to 100."""
    buffer = io.BytesIO()
    image.save(buffer, "JPEG", quality=quality)
    return buffer.getvalue()


@lru_cache(maxsize=BACKGROUNDS)
def _background(view: View) -> Image.Image:
    image = Image.new("RGB", view.size, GROUND)
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
            canvas.text(
                (x + LABEL_PX // 3, y - LABEL_PX * 1.4), f"{at_m} m", LABEL, _font(LABEL_PX)
            )
    for obstacle, (paint, _, _) in zip(World(end_m).obstacles, PAINTS, strict=True):
        left, lower, right, upper = obstacle.bounds
        draw_shape = canvas.rectangle if isinstance(obstacle, Box) else canvas.ellipse
        draw_shape(view.pixels([(left, upper), (right, lower)]), fill=paint)
    corners = view.pixels([(end_m, 0), (end_m, end_m), (0, end_m), (0, 0)])
    for paint, start, end in zip(WALLS, corners, [*corners[1:], corners[0]], strict=True):
        canvas.line([start, end], paint, width=4)
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


def _put_caption(image: Image.Image, text: str) -> None:
    # At the lower left: the page's menus lie over the upper edge, its numbers and the stamp over the lowest eighth.
    height = max(10, image.height // 34)
    caption = _caption(text, height)
    image.paste(caption, (height // 6, image.height * 7 // 8 - caption.height))


@lru_cache(maxsize=BACKGROUNDS)
def _caption(text: str, height: int) -> Image.Image:
    font, edge = _font(height), height // 3
    *_, right, bottom = ImageDraw.Draw(Image.new("L", (1, 1))).multiline_textbbox(
        (edge, edge), text, font
    )
    image = Image.new("RGB", (math.ceil(right) + edge, math.ceil(bottom) + edge), TEXT_GROUND)
    ImageDraw.Draw(image).multiline_text((edge, edge), text, TEXT, font)
    return image


@lru_cache(maxsize=BACKGROUNDS)
def _font(height: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(height)


Layer = Callable[[ImageDraw.ImageDraw, View, Scene], None]
LAYERS: tuple[Layer, ...] = (_draw_path, _draw_robot)


def _put_stamp(image: Image.Image, stamp_ns: int) -> None:
    """Draw the moment over the lower edge, so that a machine can read it back; a picture too small stays as it is.

    tests/support/fakes/frame_stamp.py reads it. Two rows of 32 cells fill the lowest twentieth of the picture, black
    for 0 and white for 1: 48 bits of Unix time in tenths of a millisecond, then CRC-16 of those six bytes (CCITT, begun
    with 0xffff), the highest bit first, the upper row first. Cells are large and grey alone, and found by parts of the
    picture's size and not by pixels: they outlive poor JPEG quality and half the size.
    """
    width, height = image.size
    if width < SMALLEST_STAMPED[0] or height < SMALLEST_STAMPED[1]:
        return
    cells = Image.frombytes(
        "L", (STAMP_COLUMNS, STAMP_ROWS), bytes(255 * bit for bit in stamp_bits(stamp_ns))
    )
    top = round(height * (1 - STAMP_ROWS * STAMP_ROW_PART))
    image.paste(cells.resize((width, height - top), Image.Resampling.NEAREST), (0, top))


def stamp_bits(stamp_ns: int) -> list[int]:
    """Give the 64 bits of a moment."""
    stamp = (stamp_ns // _NS_A_TENTH_MS).to_bytes(STAMP_BYTES, "big")
    whole = stamp + binascii.crc_hqx(stamp, _CRC_BEGIN).to_bytes(2, "big")
    return [byte >> place & 1 for byte in whole for place in range(7, -1, -1)]


@dataclass(frozen=True)
class FrameFormat:
    """How a viewer wants its frames: pixels, pixels, JPEG quality from 1 to 100."""

    width: int = 640
    height: int = 480
    quality: int = 95


@dataclass(frozen=True, slots=True)
class RenderedFrame:
    """One picture: its sequence, the Unix time of what it shows, and the JPEG."""

    sequence: int
    stamp_ns: int
    jpeg: bytes


class FrameFeed:
    """The camera's frames, in `own_format` for who requests none. `scene_of` gives the scene as it is now."""

    def __init__(self, scene_of: Callable[[], Scene], fps: float, own_format: FrameFormat) -> None:
        self.own_format = own_format
        self._scene = scene_of
        self._fps = fps
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="camera")
        self._newest: OrderedDict[FrameFormat, tuple[int, asyncio.Task[RenderedFrame]]] = (
            OrderedDict()
        )
        self._running = asyncio.Event()
        self._running.set()

    @property
    def is_frozen(self) -> bool:
        """Tell whether the camera gives nothing."""
        return not self._running.is_set()

    def freeze(self, frozen: bool) -> None:
        """Give no new frame until this is taken back."""
        if frozen:
            self._running.clear()
        else:
            self._running.set()

    async def next_frame(self, frame_format: FrameFormat, after: int = -1) -> RenderedFrame:
        """Wait for a frame with a sequence above `after`: the newest one, not the next in line."""
        sequence = await self._due(after)
        while self.is_frozen:
            await self._running.wait()
            sequence = await self._due(after)
        # Shielded: a viewer who leaves must not take the frame from the others.
        return await asyncio.shield(self._drawing(frame_format, sequence))

    async def close(self) -> None:
        """Draw nothing more."""
        drawings = [task for _, task in self._newest.values()]
        await asyncio.gather(*drawings, return_exceptions=True)
        self._thread.shutdown(cancel_futures=True)

    async def _due(self, after: int) -> int:
        loop = asyncio.get_running_loop()
        sequence = max(int(loop.time() * self._fps), after + 1)
        await asyncio.sleep(sequence / self._fps - loop.time())
        return sequence

    def _drawing(self, frame_format: FrameFormat, sequence: int) -> asyncio.Task[RenderedFrame]:
        drawing = self._newest.get(frame_format)
        if drawing is not None and drawing[0] >= sequence:
            return drawing[1]
        task = asyncio.create_task(self._draw(frame_format, sequence))
        self._newest[frame_format] = (sequence, task)
        self._newest.move_to_end(frame_format)
        if len(self._newest) > MAX_FORMATS:
            self._newest.popitem(last=False)
        return task

    async def _draw(self, frame_format: FrameFormat, sequence: int) -> RenderedFrame:
        scene = self._scene()
        loop = asyncio.get_running_loop()
        data = await loop.run_in_executor(self._thread, _frame, scene, frame_format)
        return RenderedFrame(sequence, scene.stamp_ns, data)


def _frame(scene: Scene, frame_format: FrameFormat) -> bytes:
    image = draw(scene, (frame_format.width, frame_format.height))
    return jpeg(image, frame_format.quality)


FORMAT = FrameFormat(quality=80)  # image_transport's own default


class CompressedCamera:
    """Publishes one camera's frames on `CAMERA/compressed`, as image_transport does: sensor_msgs/CompressedImage.

    `simulator` calls it at each step of the loop. Frames are drawn only while somebody is subscribed, and then come
    from the same feed as those of the video server.
    """

    def __init__(self, graph: Graph, camera: str, feed: FrameFeed) -> None:
        self.topic = f"{camera}/compressed"
        self._graph = graph
        self._feed = feed
        self._task: asyncio.Task[None] | None = None
        graph.bus.advertise(self.topic, "sensor_msgs/CompressedImage", NODE)

    def step(self) -> None:
        """Begin, if somebody listens and nothing runs yet."""
        is_running = self._task is not None and not self._task.done()
        if not is_running and self._graph.bus.has_subscribers(self.topic):
            self._task = asyncio.create_task(self._show())

    async def close(self) -> None:
        """Publish nothing more."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    async def _show(self) -> None:
        sequence = -1
        while self._graph.bus.has_subscribers(self.topic):
            frame = await self._feed.next_frame(FORMAT, after=sequence)
            sequence = frame.sequence
            if self._graph.bus.has_subscribers(self.topic):
                self._publish(frame)

    def _publish(self, frame: RenderedFrame) -> None:
        values = {
            "header": self._graph.types.header("camera", frame.stamp_ns, frame.sequence),
            "format": "jpeg",
            "data": base64.b64encode(frame.jpeg).decode(),
        }
        self._graph.bus.publish(self.topic, values)

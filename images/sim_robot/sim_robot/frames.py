"""Gives the newest camera frame to whoever asks; draws only when somebody does.

Used by video_server.py, and by `CompressedCamera` for a topic. All viewers who want the same size and quality share one
drawing. Drawing happens in one thread beside the robot's loop, and never more often than the camera's rate.
"""

import asyncio
import base64
import logging
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from sim_robot import camera
from sim_robot.bus import Node
from sim_robot.graph import Graph

log = logging.getLogger(__name__)

MAX_FORMATS = 8
NODE = Node("/camera")


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
    """The camera's frames. `look` gives the scene as it is now."""

    def __init__(self, scene_of: Callable[[], camera.Scene], fps: float) -> None:
        self._scene = scene_of
        self._fps = fps
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="camera")
        self._newest: OrderedDict[FrameFormat, tuple[int, asyncio.Task[RenderedFrame]]] = (
            OrderedDict()
        )
        self._running = asyncio.Event()
        self._running.set()
        self.drawn = 0

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

    async def next_frame(self, wanted: FrameFormat, after: int = -1) -> RenderedFrame:
        """Wait for a frame with a sequence above `after`: the newest one, not the next in line."""
        sequence = await self._due(after)
        while self.is_frozen:
            await self._running.wait()
            sequence = await self._due(after)
        # Shielded: a viewer who leaves must not take the frame from the others.
        return await asyncio.shield(self._drawing(wanted, sequence))

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

    def _drawing(self, wanted: FrameFormat, sequence: int) -> asyncio.Task[RenderedFrame]:
        known = self._newest.get(wanted)
        if known is not None and known[0] >= sequence:
            return known[1]
        task = asyncio.create_task(self._draw(wanted, sequence))
        self._newest[wanted] = (sequence, task)
        self._newest.move_to_end(wanted)
        if len(self._newest) > MAX_FORMATS:
            self._newest.popitem(last=False)
        return task

    async def _draw(self, wanted: FrameFormat, sequence: int) -> RenderedFrame:
        scene = self._scene()
        loop = asyncio.get_running_loop()
        data = await loop.run_in_executor(self._thread, _frame, scene, wanted)
        self.drawn += 1
        return RenderedFrame(sequence, scene.stamp_ns, data)


def _frame(scene: camera.Scene, wanted: FrameFormat) -> bytes:
    image = camera.draw(scene, (wanted.width, wanted.height))
    return camera.jpeg(image, wanted.quality)


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

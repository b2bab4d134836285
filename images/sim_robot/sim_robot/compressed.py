"""A camera's pictures as a topic: sensor_msgs/CompressedImage beside each camera, as image_transport offers it.

Called by simulator.py at each step of the loop. Pictures are drawn only while somebody is subscribed,
and then come from the same feed as those of the video server.
"""

import asyncio
import base64

from sim_robot.bus import Node
from sim_robot.frames import FrameFeed, FrameFormat, RenderedFrame
from sim_robot.graph import Graph

NODE = Node("/camera")
FORMAT = FrameFormat(quality=80)  # image_transport's own default


class CompressedCamera:
    """Publishes one camera's pictures on `CAMERA/compressed`."""

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

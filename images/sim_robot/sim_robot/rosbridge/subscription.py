"""One client's subscription to one topic, which may come from several calls of `subscribe`.

As in the real rosbridge, each call may have an id and its own requests; what goes out satisfies all of them.
"""

import asyncio
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from sim_robot.bus import TopicMessage
from sim_robot.rosbridge import encoding

QUEUE_LIMIT = 1000  # whatever queue_length a client asks for


class ThrottledQueue:
    """Throttles one client's messages of one topic, by rosbridge's throttle_rate and queue_length.

    Without a queue, messages that come before the throttle time is over are left out. With one, they wait, the oldest
    making room, and go out one a throttle time.
    """

    def __init__(self, send: Callable[[TopicMessage], None]) -> None:
        self._send = send
        self._loop = asyncio.get_running_loop()
        self._throttle_s = 0.0
        self._queue: deque[TopicMessage] | None = None
        self._due_s = 0.0
        self._timer: asyncio.TimerHandle | None = None

    def configure(self, throttle_ms: int, queue_length: int) -> None:
        """Set both; what waits stays, as far as it fits."""
        self._throttle_s = throttle_ms / 1000
        waiting = self._queue or ()
        length = min(queue_length, QUEUE_LIMIT)
        self._queue = deque(waiting, maxlen=length) if length else None

    def offer(self, message: TopicMessage) -> None:
        """Send a message now, later or never."""
        is_due = self._loop.time() >= self._due_s
        if self._queue is not None and (self._queue or not is_due):
            self._queue.append(message)
            self._start_timer()
        elif is_due:
            self._send_now(message)

    def close(self) -> None:
        """Forget what waits."""
        self._queue = None
        if self._timer is not None:
            self._timer.cancel()

    def _send_now(self, message: TopicMessage) -> None:
        self._due_s = self._loop.time() + self._throttle_s
        self._send(message)

    def _start_timer(self) -> None:
        if self._timer is None:
            self._timer = self._loop.call_at(self._due_s, self._send_waiting)

    def _send_waiting(self) -> None:
        self._timer = None
        if self._queue:
            self._send_now(self._queue.popleft())
        if self._queue:
            self._start_timer()


@dataclass(frozen=True, slots=True)
class SubscribeRequest:
    """What one call of `subscribe` asked for."""

    throttle_ms: int
    queue_length: int
    compression: str


class Subscription:
    """All requests for one topic and the queue that they share."""

    def __init__(self, queue: ThrottledQueue) -> None:
        self._queue = queue
        self._requests: dict[str | int | None, SubscribeRequest] = {}
        self.offer = queue.offer

    def __len__(self) -> int:
        """Count the requests."""
        return len(self._requests)

    @property
    def compression(self) -> str:
        """How messages are encoded: CBOR as soon as one request asks for it."""
        wanted = {request.compression for request in self._requests.values()}
        return encoding.CBOR if encoding.CBOR in wanted else encoding.NONE

    def add(self, identity: str | int | None, request: SubscribeRequest) -> None:
        """Add a request, or replace the one with this id."""
        self._requests[identity] = request
        self._apply()

    def remove(self, identity: str | int | None) -> None:
        """Remove the request with this id; without an id, all."""
        if identity is None:
            self._requests.clear()
        else:
            self._requests.pop(identity, None)
        self._apply()

    def close(self) -> None:
        """Deliver nothing more."""
        self._queue.close()

    def _apply(self) -> None:
        if self._requests:
            throttle_ms = min(request.throttle_ms for request in self._requests.values())
            queue_length = min(request.queue_length for request in self._requests.values())
            self._queue.configure(throttle_ms, queue_length)

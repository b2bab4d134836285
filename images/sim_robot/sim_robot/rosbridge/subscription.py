"""One client's subscription to one topic, which may come from several calls of `subscribe`.

As in the real rosbridge, each call may have an id and its own requests; what goes out satisfies all of them.
"""

from dataclasses import dataclass

from sim_robot.rosbridge import encoding
from sim_robot.rosbridge.throttled_queue import ThrottledQueue


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

"""One client of rosbridge: what it advertises, what it is subscribed to, and what waits for it, as it will be sent.

Made by server.py for each connection, changed by the operations. Knows no socket: what goes out waits
in `outbox`, which is bounded. The real rosbridge's queue is not, so a client that does not read makes it grow until the
robot has no memory left. Here the oldest make room for new ones.
"""

import asyncio
import json
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from sim_robot.graph import Graph, Node, TopicMessage
from sim_robot.messages import finite_or_none

NODE_NAME = "/rosbridge_websocket"
MESSAGES_LIMIT = 1000
BYTES_LIMIT = 16 * 1024 * 1024
QUEUE_LIMIT = 1000  # whatever queue_length a client asks for

Id = str | int | None


class Outbox:
    """A queue with one reader."""

    def __init__(self) -> None:
        self._entries: deque[str] = deque()
        self._size = 0
        self._filled = asyncio.Event()
        self.dropped = 0

    def put(self, data: str) -> None:
        """Queue a message; the oldest ones go when there is no room."""
        self._entries.append(data)
        self._size += len(data)
        while self._is_full():
            self._size -= len(self._entries.popleft())
            self.dropped += 1
        self._filled.set()

    async def get(self) -> str:
        """Wait for the next one."""
        while not self._entries:
            self._filled.clear()
            await self._filled.wait()
        data = self._entries.popleft()
        self._size -= len(data)
        return data

    def _is_full(self) -> bool:
        # One alone may be larger than the limit: it has to go out somehow.
        too_large = self._size > BYTES_LIMIT and len(self._entries) > 1
        return too_large or len(self._entries) > MESSAGES_LIMIT


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


class Subscription:
    """All requests for one topic and the queue that they share."""

    def __init__(self, queue: ThrottledQueue) -> None:
        self._queue = queue
        self._requests: dict[str | int | None, SubscribeRequest] = {}
        self.offer = queue.offer

    def __len__(self) -> int:
        """Count the requests."""
        return len(self._requests)

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


@dataclass(eq=False)
class Client:
    """The state of one connection."""

    graph: Graph
    name: str
    outbox: Outbox = field(default_factory=Outbox)
    advertised: dict[str, set[Id]] = field(default_factory=dict)
    subscriptions: dict[str, Subscription] = field(default_factory=dict)
    node: Node = field(default_factory=lambda: Node(NODE_NAME))

    def reply(self, message: dict[str, Any], identity: Id) -> None:
        """Queue a reply, with the id of what it answers."""
        if identity is not None:
            message["id"] = identity
        self.outbox.put(to_json(message))

    def deliver(self, message: TopicMessage, topic: str) -> None:
        """Queue a message for a client that knows the topic as `topic`; what several get is encoded once."""
        if topic not in message.wire:
            frame = {"op": "publish", "topic": topic, "msg": message.values}
            message.wire[topic] = to_json(frame)
        self.outbox.put(message.wire[topic])

    def close(self) -> None:
        """Give back everything that the client held."""
        for topic in self.advertised:
            self.graph.bus.unadvertise(topic, self.node)
        for topic, subscription in self.subscriptions.items():
            subscription.close()
            self.graph.bus.unsubscribe(topic, self.node)
        self.advertised.clear()
        self.subscriptions.clear()


def to_json(value: Any) -> str:
    """Write compact JSON; NaN and infinity become null."""
    try:
        return json.dumps(value, separators=(",", ":"), allow_nan=False)
    except ValueError:
        return json.dumps(finite_or_none(value), separators=(",", ":"))

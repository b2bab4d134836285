"""One client's subscription to one topic, which may come from several calls of `subscribe`.

As in the real rosbridge, each call may have an id and its own wishes; what goes out satisfies all of them.
"""

from dataclasses import dataclass

from sim_robot.rosbridge import encoding
from sim_robot.rosbridge.delivery import Delivery


@dataclass(frozen=True, slots=True)
class Wish:
    """What one call of `subscribe` asked for."""

    throttle_ms: int
    queue_length: int
    compression: str


class Subscription:
    """All wishes for one topic and the delivery that they share."""

    def __init__(self, delivery: Delivery) -> None:
        self._delivery = delivery
        self._wishes: dict[str | int | None, Wish] = {}
        self.offer = delivery.offer

    def __len__(self) -> int:
        """Count the wishes."""
        return len(self._wishes)

    @property
    def compression(self) -> str:
        """How messages are encoded: CBOR as soon as one wish wants it."""
        wanted = {wish.compression for wish in self._wishes.values()}
        return encoding.CBOR if encoding.CBOR in wanted else encoding.NONE

    def add(self, identity: str | int | None, wish: Wish) -> None:
        """Add a wish, or replace the one with this id."""
        self._wishes[identity] = wish
        self._apply()

    def remove(self, identity: str | int | None) -> None:
        """Remove the wish with this id; without an id, all."""
        if identity is None:
            self._wishes.clear()
        else:
            self._wishes.pop(identity, None)
        self._apply()

    def close(self) -> None:
        """Deliver nothing more."""
        self._delivery.close()

    def _apply(self) -> None:
        if self._wishes:
            throttle_ms = min(wish.throttle_ms for wish in self._wishes.values())
            queue_length = min(wish.queue_length for wish in self._wishes.values())
            self._delivery.configure(throttle_ms, queue_length)

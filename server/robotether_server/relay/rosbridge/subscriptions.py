"""The topics that one connection has subscribed, counted as rosbridge counts them. Pure."""

from __future__ import annotations


class Subscriptions:
    """At most so many; a topic may be subscribed several times, each under an id of its own."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._ids: dict[str, set[str | int | None]] = {}
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, topic: str, subscription_id: str | int | None) -> bool:
        """Count a subscription, an old one anew for nothing; False when there are too many."""
        ids = self._ids.get(topic, set())
        if subscription_id in ids:
            return True
        if self._count >= self._most:
            return False
        self._ids.setdefault(topic, ids).add(subscription_id)
        self._count += 1
        return True

    def remove(self, topic: str, subscription_id: str | int | None) -> None:
        """Forget the subscription; without an id, all of the topic."""
        ids = self._ids.get(topic, set())
        gone = set(ids) if subscription_id is None else ids & {subscription_id}
        ids -= gone
        self._count -= len(gone)
        if not ids:
            self._ids.pop(topic, None)

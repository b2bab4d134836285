"""Notices of topics between two cells, and what a cell notifies another of for each of that one's observers.

The cell that has the robot checks what an observer subscribes to, and the observer's own cell shares the copy among
its observers: so one copy crosses the line between them. A notice begins with a key of the cell that asked: no robot
and no client sees it.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Mapping

import msgspec
from aiohttp import WSMsgType
from msgspec import Struct

from robotether_server.relay.channels.rosbridge.held_messages import HeldMessages
from robotether_server.relay.channels.rosbridge.shared_topics import TopicRequest
from robotether_server.relay.channels.rosbridge.subscriptions import (
    Deliver,
    DeliverAtOnce,
    MessageId,
    never,
)
from robotether_server.relay.http.close_reasons import CloseReason

KEY_HEADER = "Robotether-Topics-Key"
KEY = re.compile("[0-9a-f]{32}")


class ShareNotice(Struct, frozen=True, tag="share"):
    """What an observer may have of a topic now, in place of its messages; None: nothing.

    Statuses of the topic have `message_id` as their id. With `is_new` it gets what a newcomer does.
    """

    topic: str
    subscription: TopicRequest | None
    message_id: MessageId = None
    is_new: bool = False


class FailureNotice(Struct, frozen=True, tag="failure"):
    """Why a topic brings nothing for now."""

    why: str


Notice = ShareNotice | FailureNotice
_ENCODER = msgspec.json.Encoder()
_DECODER: msgspec.json.Decoder[Notice] = msgspec.json.Decoder(Notice)


def write_notice(key: bytes, notice: Notice) -> bytes:
    """Write a notice, which is sent as a binary message."""
    return key + _ENCODER.encode(notice)


def read_notice(key: bytes, message: bytes) -> Notice | None:
    """Read a message that begins with the key; None: this version does not know such a notice."""
    try:
        return _DECODER.decode(message[len(key) :])
    except (ValueError, RecursionError):
        return None


def key_of(headers: Mapping[str, str]) -> bytes | None:
    """Return the key of a cell that shares topics among its observers; None: the request has none."""
    key = headers.get(KEY_HEADER, "")
    return key.encode() if KEY.fullmatch(key) else None


class ForwardedTopics:
    """Notifies an observer's cell of what it may share; implements `subscriptions.TopicSharing`.

    `members` are the robot's.
    """

    def __init__(self, key: bytes, user_id: int, members: set[object]) -> None:
        self.user_id = user_id
        # Nothing waits: the observer's cell knows alone when rosbridge has a subscription.
        self.held = HeldMessages()
        self._key = key
        self._members = members
        self._shared: dict[str, TopicRequest] = {}
        # The newest notice of each topic, and the topics of which the cell has one that lets it share them.
        self._notices: dict[str, ShareNotice] = {}
        self._notified: set[str] = set()
        self._due = asyncio.Event()

    def share(
        self,
        topic: str,
        subscription: TopicRequest | None,
        message_id: MessageId = None,
        *,
        is_new: bool = False,
    ) -> None:
        """Let the cell share what is requested of a topic now; None: nothing."""
        self._members.add(self)
        unsent = self._notices.pop(topic, None)
        is_new = is_new or (unsent is not None and unsent.is_new)
        if subscription is not None:
            self._shared[topic] = subscription
        else:
            self._shared.pop(topic, None)
            if topic not in self._notified:
                return
        self._notices[topic] = ShareNotice(topic, subscription, message_id, is_new)
        self._due.set()

    async def send(self, deliver: Deliver, _at_once: DeliverAtOnce = never) -> CloseReason:
        """Send the notices until this is cancelled."""
        while True:
            await self._due.wait()
            self._due.clear()
            while self._notices:
                notice = self._notices.pop(next(iter(self._notices)))
                if notice.subscription is None:
                    self._notified.discard(notice.topic)
                else:
                    self._notified.add(notice.topic)
                await deliver(write_notice(self._key, notice), WSMsgType.BINARY)

    def close(self) -> None:
        """Share nothing any more; the observer's cell sees the connection's end."""
        self._members.discard(self)

    def shares(self, key: bytes, subscription: TopicRequest) -> bool:
        """Return whether the cell with this key has its copy of a topic for the observer, too."""
        return self._key == key and self._shared.get(subscription.topic) == subscription


def users_sharing(members: set[object], key: bytes, subscription: TopicRequest) -> set[int]:
    """Return the users for whom the cell with this key has its copy of a topic; `members` are the robot's."""
    return {
        each.user_id
        for each in members
        if isinstance(each, ForwardedTopics) and each.shares(key, subscription)
    }

"""Answers /apps/NAME/ros: web apps as ends of routes, each of them its user's, while it is connected.

An app speaks rosbridge: it advertises and publishes what routes take from it, and subscribes to what they bring. It
reaches no robot by itself: `routes` lets a route of its user read it, or write to it. The age of what it publishes is
bounded as that of a client without timestamps (docs/adr/0010-age-is-a-bound.md).
"""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Literal

from aiohttp import WSMsgType, web
from robotether_common.own_topics import same_type
from robotether_common.ros import full_name

from robotether_server.contract.routes import AppTopic, LiveApp
from robotether_server.db.fleet import AuditEntry
from robotether_server.problems import HttpError, TokenInvalidError
from robotether_server.relay.auth.access import Access, credential_in, request_of
from robotether_server.relay.auth.credentials import Credentials
from robotether_server.relay.cells.messages import PeerApp
from robotether_server.relay.channels.rosbridge.bridge import PASSED_ON
from robotether_server.relay.channels.rosbridge.drive_path import CommandTimestamps
from robotether_server.relay.channels.rosbridge.handler import BridgeRules
from robotether_server.relay.channels.rosbridge.message_validator import (
    ANSWERS_PER_S,
    FLOOD_AFTER_S,
    TOO_MANY,
    message_cost,
    refusal,
)
from robotether_server.relay.channels.rosbridge.operations import (
    NotJsonError,
    read_json,
    write_json,
)
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import CloseReason
from robotether_server.relay.http.event_loop import PieceTurns, next_turn
from robotether_server.relay.http.sockets import ClientConnection, OperatorSocket
from robotether_server.relay.http.timing import Excess, LivenessLimits, RateLimiter
from robotether_server.relay.records.event_writer import EventWriter
from robotether_server.relay.routes.source import LOOK_EVERY_S, RouteSource, SourceMessage
from robotether_server.tasks import wait_for_event
from robotether_server.times import utc_now

PATH = "/apps/{name:[a-z0-9-]{1,63}}/ros"
# Maximum number of a user's apps, and of an app's topics either way.
MAX_APPS, MAX_TOPICS = 8, 32
MAX_ID_LENGTH = 255
OPERATIONS = ("advertise", "publish", "unadvertise", "subscribe", "unsubscribe")
TYPE_NAME = re.compile(r"[\w/]{1,255}", re.ASCII)
MAX_MESSAGE_BYTES = 256 * 1024
# Maximum rate of messages of all apps of a user; large ones count more than once.
MAX_MESSAGES_PER_S = 1000
# Maximum number of times that apps of a user connect in a row.
MAX_CONNECTS_AT_ONCE, CONNECT_EVERY_S = 20, 3.0
# Time for which it is known what a user without apps has used of these.
QUOTA_KEPT_S = 60.0
CLOCK_SYNC = "robotether.clock_sync"

# A user, by id, and the app's name.
AppKey = tuple[int, str]
# Types, by topic and by the app's id: it may advertise or subscribe to a topic several times, as with rosbridge.
Topics = dict[str, dict[str, str]]


class AppQuota:
    """What all apps of a user may use together; it outlives their connections."""

    def __init__(self) -> None:
        now = self.used_s = time.monotonic()
        self._messages = RateLimiter(now, per_s=MAX_MESSAGES_PER_S, at_once=MAX_MESSAGES_PER_S)
        self._excess = Excess(now, per_s=MAX_MESSAGES_PER_S, for_s=FLOOD_AFTER_S)
        self._connects = RateLimiter(now, per_s=1 / CONNECT_EVERY_S, at_once=MAX_CONNECTS_AT_ONCE)

    def connect(self) -> bool:
        """Count a connection; return whether it may be."""
        self.used_s = time.monotonic()
        return self._connects.allow(self.used_s)

    def message(self, now: float, cost: int) -> Literal["read", "refused", "flood"]:
        """Count a message; return what becomes of it; who sends a flood has gone on with too many for too long."""
        self.used_s = now
        if self._messages.allow(now, cost):
            return "read"
        return "flood" if self._excess.add(now, cost) else "refused"


class App(ClientConnection):
    """One app that is connected."""

    def __init__(
        self,
        key: AppKey,
        quota: AppQuota,
        socket: OperatorSocket,
        limits: LivenessLimits,
        turns: PieceTurns,
        *,
        address: str | None,
    ) -> None:
        super().__init__(f"app {key[1]}", socket, limits)
        self.key = key
        self.address = address
        self._quota = quota
        self._turns = turns
        self._offered: Topics = {}
        self._taken: Topics = {}
        # The names by which the app knows what it takes, perhaps without the first slash.
        self._short_names: dict[str, str] = {}
        # The routes from it and to it.
        self._readers: set[RouteSource] = set()
        self._sources: dict[int, RouteSource] = {}
        self._due = asyncio.Event()
        self._timestamps = CommandTimestamps(self._received_s)
        self._answers = RateLimiter(self._received_s, per_s=ANSWERS_PER_S, at_once=ANSWERS_PER_S)

    def describe(self) -> LiveApp:
        """Describe it as it is now."""
        offered, taken = (
            [AppTopic(topic, [*topics[topic].values()][-1]) for topic in sorted(topics)]
            for topics in (self._offered, self._taken)
        )
        return LiveApp(self.key[1], offered, taken)

    def read(self, source: RouteSource) -> None:
        """Give a route what the app publishes on its topic from now on."""
        self._readers.add(source)
        source.problem = self._why_unread(source)

    def leave(self, source: RouteSource) -> None:
        """Give a route nothing any more."""
        self._readers.discard(source)

    def wake(self) -> None:
        """A route to it has a message."""
        self._due.set()

    def add(self, source: RouteSource) -> None:
        """Send the app what this route brings from now on."""
        self._sources[source.route.id] = source
        self.wake()

    def remove(self, source: RouteSource) -> None:
        """Send the app nothing of this route any more."""
        self._sources.pop(source.route.id, None)

    async def run(self) -> CloseReason:
        """Pass messages until the end; return why."""
        return await self._run_until_ended(
            self._run_together(self._receive_all(), self._send_all())
        )

    def _next_ping(self) -> bytes:
        return self._timestamps.ping(time.monotonic())

    async def _receive_all(self) -> CloseReason:
        count = 0
        while True:
            count = await next_turn(count)
            message = await self._receive()
            if message.type not in PASSED_ON:
                return self._close_reason_by_client(message)
            # Before any of it is read.
            verdict = self._quota.message(self._received_s, message_cost(message.data))
            if verdict == "flood":
                return CloseReason("client_floods", "your apps sent too much for too long")
            if message.type is WSMsgType.PONG:
                self._timestamps.pong(message.data)
            elif message.type is WSMsgType.PING:
                await self._socket.pong(message.data)
            elif (answer := self._answer(message.data, verdict)) is not None:
                await self._send(answer)

    def _answer(self, data: bytes, verdict: str) -> bytes | None:
        """Do as a message says; return what tells the app that it is refused, or answers its clock sync."""
        if verdict == "refused":
            return self._refusal(TOO_MANY, {})
        try:
            message = read_json(data)
        except NotJsonError as problem:
            return self._refusal(f"cannot read the message: {problem}", {})
        if message.get("op") == CLOCK_SYNC:
            # By the answers the app's page knows that the connection still is.
            relay_ms = round(self._received_s * 1000, 3)
            return write_json({**message, "relay_ms": relay_ms})
        why = self._perform(message, data)
        return None if why is None else self._refusal(why, message)

    def _refusal(self, why: str, message: Mapping[str, Any]) -> bytes | None:
        """Return the answer; None: there were enough of them this second."""
        is_answered = self._answers.allow(self._received_s)
        return refusal(why, message) if is_answered else None

    def _perform(self, message: dict[str, Any], data: bytes) -> str | None:
        """Do as a message says; return why not."""
        op, topic = message.get("op"), full_name(message.get("topic"))
        if op not in OPERATIONS:
            return "cannot use the message: an app may only use the operations of topics"
        if topic is None:
            return "cannot use the message: `topic` must be a topic's name"
        message_id = "" if message.get("id") is None else str(message["id"])[:MAX_ID_LENGTH]
        match op:
            case "publish":
                return self._publish(topic, data)
            case "advertise":
                return self._note(self._offered, topic, message_id, message.get("type"))
            case "subscribe":
                why = self._note(self._taken, topic, message_id, message.get("type"))
                if why is None:
                    self._short_names[topic] = message["topic"]
                return why
            case "unadvertise":
                self._forget(self._offered, topic, message_id)
            case "unsubscribe":
                self._forget(self._taken, topic, message_id)
                if topic not in self._taken:
                    self._short_names.pop(topic, None)
        return None

    def _publish(self, topic: str, data: bytes) -> str | None:
        if topic not in self._offered:
            return f"cannot publish on {topic}: advertise it first"
        since_s = self._timestamps.of(None, self._received_s)
        for source in self._readers:
            if source.route.source_topic == topic and not self._why_unread(source):
                source.receive(SourceMessage(data, since_s))
        return None

    def _note(self, topics: Topics, topic: str, message_id: str, type_name: object) -> str | None:
        if not isinstance(type_name, str) or not TYPE_NAME.fullmatch(type_name):
            return f"cannot use {topic}: `type` must be its type"
        types = topics.get(topic, {})
        if message_id not in types and sum(map(len, topics.values())) >= MAX_TOPICS:
            return f"cannot use {topic}: an app has at most {MAX_TOPICS} topics either way"
        topics[topic] = types | {message_id: type_name}
        self._explain()
        return None

    def _forget(self, topics: Topics, topic: str, message_id: str) -> None:
        types = topics.pop(topic, {})
        types.pop(message_id, None)
        if types and message_id:
            topics[topic] = types
        self._explain()

    def _explain(self) -> None:
        for source in self._readers:
            source.problem = self._why_unread(source)

    def _why_unread(self, source: RouteSource) -> str:
        """Say why a route gets nothing of the app; empty: it may."""
        return _why_unfit(self._offered, source.route.source_topic, source, "offer")

    async def _send_all(self) -> CloseReason:
        while True:
            now_s = time.monotonic()
            waits_s = [source.due_in_s(now_s) for source in self._sources.values()]
            due_s = min((each for each in waits_s if each is not None), default=None)
            if due_s == 0.0 and not self._socket.waiting_bytes():
                await self._send_due()
                continue
            await wait_for_event(self._due, None if due_s is None else max(due_s, LOOK_EVERY_S))

    async def _send_due(self) -> None:
        for source in list(self._sources.values()):
            if source.due_in_s(time.monotonic()) != 0.0:
                continue
            # Each may be large.
            await asyncio.sleep(0)
            message, topic = source.take(time.monotonic()), source.route.target_topic
            source.problem = _why_unfit(self._taken, topic, source, "subscribe to")
            if message is None or source.problem:
                continue
            if (content := self._content(source, message.data)) is not None:
                name = self._short_names[topic]
                await self._send(write_json({"op": "publish", "topic": name, "msg": content}))
                source.on_sent(time.monotonic())

    def _content(self, source: RouteSource, data: bytes) -> dict[str, Any] | None:
        """Read what a robot sent, unless that would take long."""
        if len(data) > MAX_MESSAGE_BYTES:
            source.problem = f"the message has over {MAX_MESSAGE_BYTES >> 10} KB, the limit of apps"
            return None
        return source.content(data, may_hold_null=True)

    async def _send(self, data: bytes) -> None:
        self._bytes_to_client += len(data)
        await self._socket.send_message(data, WSMsgType.TEXT, self._turns)


def _why_unfit(topics: Topics, topic: str, source: RouteSource, verb: str) -> str:
    types = topics.get(topic, {}).values()
    if not types:
        return f"the app does not {verb} {topic}"
    is_fit = same_type(source.route.type) in map(same_type, types)
    return "" if is_fit else f"the app has {topic} with another type"


class Apps:
    """The apps that are connected here."""

    def __init__(
        self,
        access: Access,
        credentials: Credentials,
        event_writer: EventWriter,
        rules: BridgeRules,
    ) -> None:
        self._access = access
        self._credentials = credentials
        self._event_writer = event_writer
        self._rules = rules
        self._apps: dict[AppKey, App] = {}
        # By user.
        self._quotas: dict[int, AppQuota] = {}
        # Is called when an app came or left.
        self.on_change: Callable[[], None] = lambda: None

    def count(self) -> int:
        """How many apps there are."""
        return len(self._apps)

    def get(self, user_id: int, name: str) -> App | None:
        """Return a user's app, if it is connected."""
        return self._apps.get((user_id, name))

    def list_all(self) -> list[PeerApp]:
        """List all for other cells."""
        return [PeerApp(*key, app.address) for key, app in self._apps.items()]

    def of_user(self, user_id: int) -> list[App]:
        """Return a user's apps."""
        return [app for key, app in self._apps.items() if key[0] == user_id]

    def end_all(self, close_reason: CloseReason) -> None:
        """End every connection."""
        for app in self._apps.values():
            app.end(close_reason)

    async def handle(self, request: web.Request) -> web.StreamResponse:
        """Serve an app until it leaves, or its user's login or token ends."""
        if not web.WebSocketResponse().can_prepare(request):
            raise HttpError(426, "cannot connect the app: connect with a WebSocket")
        ticket = self._access.for_app(request_of(request), request.match_info["name"])
        key = (ticket.user_id, ticket.robot)
        quota = self._quota(ticket.user_id)
        if not quota.connect():
            raise HttpError(429, f"cannot connect app {key[1]}: your apps connect too often")
        # It may drive from its first message on, and `held` alone would let it for a second.
        if not await self._credentials.holds(credential_in(ticket)):
            raise TokenInvalidError(f"cannot connect app {key[1]}: your login or token has ended")
        if key in self._apps:
            raise HttpError(409, f"cannot connect app {key[1]}: one of that name is connected")
        if len(self.of_user(ticket.user_id)) >= MAX_APPS:
            raise HttpError(429, f"cannot connect app {key[1]}: you have {MAX_APPS} connected")
        socket = OperatorSocket(MAX_MESSAGE_BYTES)
        address = request.headers.get("X-Forwarded-For")
        limits, turns = self._rules.driver_limits, self._rules.traffic.piece_turns
        app = App(key, quota, socket, limits, turns, address=address)
        ended = CloseReason("rights_ended", "your login or token has ended")
        self._apps[key] = app
        try:
            with self._credentials.held(credential_in(ticket), partial(app.end, ended)):
                await socket.open(request)
                self.on_change()
                close_reason = await self._run(app, ticket.user)
        finally:
            del self._apps[key]
            self.on_change()
        await socket.finish(close_reason)
        return socket

    async def _run(self, app: App, user: str) -> CloseReason:
        """Run an app between its two lines of the audit log."""
        self._audit(app, user, "app_connected")
        begun_s, close_reason = time.monotonic(), close_reasons.client_vanished(app.name)
        try:
            close_reason = await app.run()
        except asyncio.CancelledError:
            close_reason = await app.close_reason_of_gone()
            raise
        finally:
            lasted_s = round(time.monotonic() - begun_s, 1)
            end = {"end_code": close_reason.name, "lasted_s": lasted_s}
            self._audit(app, user, "app_disconnected", **end)
        return close_reason

    def _audit(self, app: App, user: str, kind: str, **details: object) -> None:
        self._event_writer.add(
            AuditEntry(utc_now(), user, kind, None, app.address, {"app": app.key[1], **details})
        )

    def _quota(self, user_id: int) -> AppQuota:
        """Return a user's quota; those that nobody needs any more are forgotten."""
        since_s = time.monotonic() - QUOTA_KEPT_S
        self._quotas = {
            each: quota
            for each, quota in self._quotas.items()
            if quota.used_s > since_s or self.of_user(each)
        }
        return self._quotas.setdefault(user_id, AppQuota())

"""The session's protocol over the lines of one SSH connection (docs/reference/protocols.md, "The session").

Run by robotether_agent.tunnel.connection. Never trusts a field unseen, never waits for the server without a
bound, and never holds more than 64 KiB in either direction.
"""

from __future__ import annotations

import asyncio
import logging
import re
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NoReturn, Protocol, cast, get_args

from robotether_common.audit_head import MAX_POSITION
from robotether_common.services import SERVICES, ForwardedService, ServiceName
from robotether_common.session import MAX_FENCE, ServiceState

from robotether_agent.battery import BatterySettings, Unit
from robotether_agent.clock import robot_time
from robotether_agent.fields import (
    ROBOT_NAME,
    TOPIC,
    FieldError,
    JsonObject,
    ListedCell,
    get_cells,
    get_flag,
    get_int,
    get_match,
    get_number,
    get_object,
    get_optional_number,
    get_optional_port,
    get_text,
    line_of,
    parse_object,
)
from robotether_agent.help.rules import HelpConfig, help_config
from robotether_agent.problems import (
    ProtocolBrokenError,
    Retry,
    ServerSilentError,
    SessionEndedError,
)
from robotether_agent.tasks import first_of

MESSAGE_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")
SOMEBODY = "somebody"
# Time limit until the server has sent its own limits: log-in, key look-up, and the end of an older
# session.
FIRST_TIMEOUT_S = 30.0
# Interval between checks of the time limit, which a configuration may shorten.
CHECK_EVERY_S = 1.0
# Minimum delay of a check that shows that this process was suspended: the server is not to blame.
FROZEN_S = 0.5
MAX_UNSENT_BYTES = 64 * 1024
MAX_PINGS = 16
SERVICE = re.compile("|".join(get_args(ServiceState)))
SHA256 = re.compile(r"[0-9a-f]{64}")
CODE = re.compile(r"[a-z][a-z0-9_]{0,49}")

BYE_ADVICE = {
    "superseded": "if this repeats, two robots use one key: remove the key and enrolment of the copied one",
    "robot_disabled": "enable the robot on the server's page",
    "robot_unknown": "the robot was removed on the server; it must be enrolled again",
    "key_changed": "the server has another key for this robot now; the next attempt asks why",
}
SLOW_BYES = frozenset({"superseded", "robot_disabled", "robot_unknown"})
# The next cell waits, and this one sends its robots away one after the other.
AT_ONCE_BYES = frozenset({"cell_draining", "rebalanced"})
# The cell lets robots in, but has no relay for them. The session command says the second one in the relay's place.
NO_RELAY_BYES = frozenset({"relay_stopping", "relay_lost"})

log = logging.getLogger(__name__)


def retry_after_bye(code: str) -> Retry:
    """Return when to connect again after the server has said goodbye."""
    if code in AT_ONCE_BYES:
        return Retry.AT_ONCE
    return Retry.SLOWLY if code in SLOW_BYES else Retry.SOON


class DriveMessageHandler(Protocol):
    """Does what the server says about driving."""

    def on_config(self, guard: JsonObject, *, direct: bool) -> None:
        """The session is up, and `guard` is the guard's configuration."""

    def on_lease(self, fence: int, *, held: bool) -> None:
        """The newest fencing number, and whether it is held; if not, all up to it are over."""

    def on_stop(self, message_id: str, by: str) -> None:
        """Stop the robot; the answer names `message_id`."""

    def on_release(self, message_id: str, by: str) -> None:
        """Let a stopped robot be driven again; the answer names `message_id`."""

    def on_session_lost(self) -> None:
        """The connection that carried the session has ended."""


def message_handlers(handler: DriveMessageHandler) -> Mapping[str, Callable[[JsonObject], None]]:
    """Return what reads each kind of line; they raise FieldError."""

    def on_lease(message: JsonObject) -> None:
        fence = get_int(message, "fence", 0, MAX_FENCE)
        handler.on_lease(fence, held=get_flag(message, "held", default=False))

    def on_stop(message: JsonObject) -> None:
        message_id = get_text(message, "id", default="")
        handler.on_stop(message_id, get_text(message, "by", default=SOMEBODY))

    def on_release(message: JsonObject) -> None:
        message_id = get_match(message, "id", MESSAGE_ID, "a short id")
        handler.on_release(message_id, get_text(message, "by", default=SOMEBODY))

    return {"lease": on_lease, "stop": on_stop, "release": on_release}


class FeatureRequest(asyncio.Event):
    """Set while the server requests something; `number` counts the requests."""

    number = 0

    def set(self) -> None:
        """Begin a request, unless there is one."""
        if not self.is_set():
            self.number += 1
        super().set()

    def end(self, number: int) -> None:
        """End the request of this number; one that has come since stays."""
        if self.number == number:
            self.clear()


class RequestedFeatures:
    """What a configuration asks for: one event a feature, set for as long as it is requested."""

    def __init__(self, *, allows_shell: bool) -> None:
        self.media = FeatureRequest()
        self.shell = FeatureRequest()
        self.new_key = FeatureRequest()
        self._allows_shell = allows_shell
        self._key_was_requested = False

    def apply(self, config: SessionConfig) -> None:
        """Follow a configuration."""
        _set(self.media, config.media)
        _set(self.shell, self._allows_shell and config.ports["shell"] is not None)
        # A configuration may still say so shortly after the key was changed: only a new request counts.
        if config.rotate_key != self._key_was_requested:
            _set(self.new_key, config.rotate_key)
        self._key_was_requested = config.rotate_key


def _set(event: asyncio.Event, is_requested: object) -> None:
    if is_requested:
        event.set()
    else:
        event.clear()


@dataclass(frozen=True)
class SessionConfig:
    """What the server wants; it may send another one at any time."""

    robot: str
    # The server's port of each service; None where the robot has none.
    ports: Mapping[ServiceName, int | None]
    heartbeat_s: float
    timeout_s: float
    # The guard's configuration, its key included.
    guard: JsonObject = field(repr=False)
    rotate_key: bool = False
    media: bool = True
    direct: bool = False
    battery: BatterySettings = field(default_factory=BatterySettings)
    help: HelpConfig = field(default_factory=HelpConfig)
    # While nobody uses the robot; nothing else follows from it.
    idle_heartbeat_s: float | None = field(default=None, compare=False)
    # How the server's logs name the session's SSH connection; empty: unknown.
    connection_id: str = field(default="", compare=False)
    # The server's cells, empty where it names none.
    cells: tuple[ListedCell, ...] = field(default=(), compare=False)

    @property
    def heartbeat_every_s(self) -> float:
        """The time between two heartbeats of a side now."""
        return self.idle_heartbeat_s or self.heartbeat_s


@dataclass(frozen=True)
class HeadRequest:
    """A line of the audit log to sign; `newest` is the SHA-256 of the newest statement that the server has."""

    chain: str
    position: int
    hash: str
    newest: str | None


def _port(message: JsonObject, service: ForwardedService) -> int | None:
    name = service.port_member
    return (
        get_optional_port(message, name)
        if service.is_optional
        else get_int(message, name, 1, 65535)
    )


UNIT = re.compile("fraction|percent")


def _battery_settings(message: JsonObject) -> BatterySettings:
    """Return what the server's settings say of the battery; a server before them says nothing."""
    battery = get_object(message, "battery") if "battery" in message else {}
    topic, unit = battery.get("topic"), battery.get("unit")
    return BatterySettings(
        None if topic is None else get_match(battery, "topic", TOPIC, "a topic's full name"),
        None
        if unit is None
        else cast("Unit", get_match(battery, "unit", UNIT, "fraction or percent")),
        get_text(battery, "drive_topic", default=""),
    )


# How the robot's services answer the server at its own end of the tunnels: ok, down or unknown.
Checked = Mapping[ServiceName, str]
UNCHECKED: Checked = {service.name: "unknown" for service in SERVICES}


class Session:
    """Both ways of one session, and what it brought last.

    `rtt_ms` is the newest round trip, `config` the newest configuration, `checked` what the server found at
    its own end of the tunnels. Its clock is the one that the guard judges ages by: the
    server learns from the pings' `t_ms` what it shows.
    """

    def __init__(
        self,
        lines_in: asyncio.StreamReader,
        lines_out: asyncio.StreamWriter,
        *,
        drive_handler: DriveMessageHandler | None = None,
        on_config: Callable[[SessionConfig], None] | None = None,
    ) -> None:
        self.config: SessionConfig | None = None
        self.rtt_ms: float | None = None
        self.checked = UNCHECKED
        self._in = lines_in
        self._out = lines_out
        self._received_at = robot_time()
        self._drive_handler = drive_handler
        self._config_handler = on_config
        self._configured = asyncio.Event()
        self._pings: deque[tuple[int, float]] = deque(maxlen=MAX_PINGS)
        # The numbers of the newest ping that was sent, and of the newest that was answered.
        self._ping_seq = self._pong_seq = 0
        self._answered = asyncio.Event()
        self._heartbeat_due = asyncio.Event()
        # Holds the newest request alone: it takes the place of one that waits.
        self._head_request: asyncio.Queue[HeadRequest] = asyncio.Queue()
        self._handlers: Mapping[str, Callable[[JsonObject], None]] = {
            "config": self._on_config,
            "ping": self._on_ping,
            "pong": self._on_pong,
            "checked": self._on_checked,
            "sign_head": self._on_sign_head,
            "bye": self._on_bye,
            **({} if drive_handler is None else message_handlers(drive_handler)),
        }

    async def run(self) -> None:
        """Serve until the stream ends; raise why if the server or a time-out ended it."""
        await first_of(self._listen(), self._send_heartbeats(), self._end_silence())

    async def new_config(self, config: SessionConfig | None) -> SessionConfig:
        """Return the newest configuration as soon as it is another one than `config`."""
        while self.config is None or self.config == config:
            self._configured.clear()
            await self._configured.wait()
        return self.config

    async def next_head_request(self) -> HeadRequest:
        """Wait until the server asks for a signature of its audit log."""
        return await self._head_request.get()

    def send(self, message: Mapping[str, object]) -> None:
        """Send one message; a server that takes none for long ends the session."""
        if self._out.transport.get_write_buffer_size() > MAX_UNSENT_BYTES:
            raise ServerSilentError("lost the session: the server no longer reads")
        self._out.write(line_of(message))

    async def until_read(self) -> None:
        """Wait until the server has read all that was sent so far: it reads in order, and has answered a later ping."""
        seq = self._ping_seq
        while self._pong_seq <= seq:
            self._answered.clear()
            await self._answered.wait()

    @property
    def silent_s(self) -> float:
        """Seconds since the server sent something, or since the start."""
        return robot_time() - self._received_at

    @property
    def is_used(self) -> bool:
        """Whether the server says that somebody uses the robot; with published ports it cannot know."""
        config = self.config
        return config is not None and config.idle_heartbeat_s is None and not config.direct

    @property
    def idle_delay_s(self) -> float:
        """Seconds by which the server's heartbeats come later than those of a robot in use."""
        config = self.config
        return 0.0 if config is None else config.heartbeat_every_s - config.heartbeat_s

    @property
    def _timeout_s(self) -> float:
        return FIRST_TIMEOUT_S if self.config is None else self.config.timeout_s

    async def _listen(self) -> None:
        while line := await self._line():
            self._received_at = robot_time()
            self._handle(line)

    async def _line(self) -> bytes:
        """Return the next line, or nothing at the stream's end."""
        try:
            return await self._in.readuntil(b"\n")
        except asyncio.IncompleteReadError:
            return b""
        except asyncio.LimitOverrunError as error:
            raise ProtocolBrokenError(
                "lost the session: the server sent a line over 64 KiB"
            ) from error

    async def _end_silence(self) -> NoReturn:
        """Raise ServerSilentError when nothing was received for too long; a time-out of each line would cost more."""
        while True:
            left_s = self._timeout_s - self.silent_s
            if left_s <= 0:
                why = f"the server was silent for {self._timeout_s:g} s"
                retry = Retry.SOON if left_s > -FROZEN_S else Retry.AT_ONCE
                raise ServerSilentError(f"lost the session: {why}", retry=retry)
            await asyncio.sleep(min(left_s, CHECK_EVERY_S))

    def _handle(self, line: bytes) -> None:
        try:
            message = parse_object(line, "the line")
            kind = get_text(message, "type")
            handler = self._handlers.get(kind)
            if handler is None:
                log.debug("ignoring a message of the unknown type %r", kind)
                return
            handler(message)
        except FieldError as error:
            raise ProtocolBrokenError(
                f"lost the session: the server sent a broken line: {error}"
            ) from error

    def _on_config(self, message: JsonObject) -> None:
        idle_delay_s = self.idle_delay_s
        self.config = SessionConfig(
            robot=get_match(message, "robot", ROBOT_NAME, "a robot's name"),
            ports={service.name: _port(message, service) for service in SERVICES},
            heartbeat_s=get_number(message, "heartbeat_s", 0.05, 60),
            timeout_s=get_number(message, "timeout_s", 0.1, 600),
            rotate_key=get_flag(message, "rotate_key", default=False),
            media=get_flag(message, "media", default=True),
            guard=get_object(message, "guard"),
            direct=get_flag(message, "direct", default=False),
            battery=_battery_settings(message),
            # A server before this member has no rules, and does not know what asks for help.
            help=help_config(get_object(message, "help")) if "help" in message else HelpConfig(),
            idle_heartbeat_s=get_optional_number(message, "idle_heartbeat_s", 0.05, 60),
            connection_id=get_text(message, "connection_id", default=""),
            cells=get_cells(message, "cells"),
        )
        if self._config_handler is not None:
            # At once: a bye that follows may send the robot to another cell.
            self._config_handler(self.config)
        if self.idle_delay_s < idle_delay_s:
            # Somebody is about to use the robot: the quick heartbeats begin at once.
            self._heartbeat_due.set()
        if self._drive_handler is not None:
            # Before the forward is opened, and before a lease or a stop that follows.
            self._drive_handler.on_config(self.config.guard, direct=self.config.direct)
        self._configured.set()

    def _on_ping(self, message: JsonObject) -> None:
        self.send({"type": "pong", "seq": get_int(message, "seq", 0, 2**53)})

    def _on_pong(self, message: JsonObject) -> None:
        seq = get_int(message, "seq", 0, 2**53)
        self._pong_seq = max(self._pong_seq, seq)
        self._answered.set()
        # The time comes from our own list, not from the echo, which the server could have changed.
        sent = next((at for number, at in self._pings if number == seq), None)
        if sent is not None:
            self.rtt_ms = (robot_time() - sent) * 1000

    def _on_checked(self, message: JsonObject) -> None:
        self.checked = {
            service.name: get_match(message, service.name, SERVICE, "ok, down or unknown")
            for service in SERVICES
        }

    def _on_sign_head(self, message: JsonObject) -> None:
        request = HeadRequest(
            chain=get_match(message, "chain", ROBOT_NAME, "a robot's name"),
            position=get_int(message, "position", 1, MAX_POSITION),
            hash=get_match(message, "hash", SHA256, "a SHA-256 in hex"),
            newest=None
            if message.get("newest") is None
            else get_match(message, "newest", SHA256, "a SHA-256 in hex"),
        )
        if not self._head_request.empty():
            self._head_request.get_nowait()
        self._head_request.put_nowait(request)

    def _on_bye(self, message: JsonObject) -> None:
        code = get_match(message, "code", CODE, "a short code")
        detail = get_text(message, "detail", default="without a reason")
        raise SessionEndedError(
            f"the server ended the connection: {detail}",
            code=code,
            retry=retry_after_bye(code),
            advice=BYE_ADVICE.get(code, ""),
        )

    async def _send_heartbeats(self) -> None:
        config = await self.new_config(None)
        while True:
            self._ping_seq += 1
            now = robot_time()
            self._pings.append((self._ping_seq, now))
            self.send({"type": "ping", "seq": self._ping_seq, "t_ms": round(now * 1000, 3)})
            config = self.config or config
            await self._until_heartbeat(config.heartbeat_every_s)

    async def _until_heartbeat(self, most_s: float) -> None:
        # A timer, as a task for each wait would cost more.
        timer = asyncio.get_running_loop().call_later(most_s, self._heartbeat_due.set)
        try:
            await self._heartbeat_due.wait()
        finally:
            timer.cancel()
        self._heartbeat_due.clear()

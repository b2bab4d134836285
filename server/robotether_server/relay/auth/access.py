"""Decides who may open what, by tickets, logins, API tokens and the page's origin.

The handlers of `app` ask here before anything else happens. A refusal is a RobotetherError with its code.
The ids of used tickets are remembered as long as a ticket is good, in bounded memory.
"""

from __future__ import annotations

import re
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import partial
from urllib.parse import urlsplit

from aiohttp import web

from robotether_server.contract.control import mac_of
from robotether_server.db.fleet import RECORDER, Credential, RelayRobot, RelayUser, Snapshot
from robotether_server.identity import normalise_mac
from robotether_server.problems import (
    CsrfRefusedError,
    GrantMissingError,
    LoginMissingError,
    OriginRefusedError,
    RobotUnknownError,
    StoreUnavailableError,
    ThrottledError,
    TicketExpiredError,
    TicketForeignError,
    TicketForgedError,
    TicketMalformedError,
    TicketMissingError,
    TicketUsedError,
    TokenInvalidError,
)
from robotether_server.relay.auth.connections import Connections
from robotether_server.relay.auth.credentials import Credentials, credential_of
from robotether_server.relay.http import close_reasons
from robotether_server.relay.http.close_reasons import ConnectionClosedError
from robotether_server.relay.robots.connection import Connection, Use, permits
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.robot_dialer import RobotDialer
from robotether_server.relay.robots.uplink import ReceivedBytes
from robotether_server.schemas import Level
from robotether_server.settings.server import RelaySettings
from robotether_server.tickets import RECORDER_SALT, CredentialKind, Ticket, TicketSigner
from robotether_server.times import utc_now

LOGIN_COOKIE = "__Host-robotether_login"
ROBOT_NAME = re.compile(r"[a-z0-9-]{1,63}")
HTTPS_PORT = 443
MAX_USED_TICKETS = 20_000
# Maximum length of a credential; a longer text is none of ours and need not be hashed.
MAX_CREDENTIAL_LENGTH = 512


@dataclass(frozen=True)
class Request:
    """What of an HTTP request says who asks."""

    host: str
    origin: str | None
    ticket: str | None
    login: str | None
    authorization: str | None
    # Of the client, as nginx saw it.
    address: str = ""
    # Of a page of this site, which alone can send it.
    csrf_header: str = ""
    # Of the robot that is meant, as another one may have its name by now.
    mac: str | None = None
    stops: bool = False


@dataclass(frozen=True)
class AuthenticatedUser:
    """A user, and the credential that showed it."""

    user: RelayUser
    credential: Credential


@dataclass(frozen=True)
class Permit:
    """A user may use this robot so, as long as the credential holds; the recorder has none."""

    user: RelayUser
    robot: RelayRobot
    use: Use
    credential: Credential | None
    # What the connection may do: a manager's observing connection only observes.
    level: Level = "observe"
    # Whether the user could drive the robot, whatever this is for.
    may_drive: bool = False


class UsedTickets:
    """The tickets that have opened a connection, by no clock: one that is set back makes an old ticket good again."""

    def __init__(self, started_at: datetime, capacity: int = MAX_USED_TICKETS) -> None:
        # A signature's timestamp has whole seconds. Older ones may have been used at a relay before.
        self._floor = started_at.replace(microsecond=0)
        self._capacity = capacity
        self._issued: OrderedDict[str, datetime] = OrderedDict()

    def refuse_too_old(self, issued_at: datetime, now: datetime) -> None:
        """Raise TicketExpiredError when this relay cannot know whether the ticket was used."""
        # The clock may have been set back since the start; else every ticket was too old until it catches up.
        self._floor = min(self._floor, now.replace(microsecond=0))
        if issued_at < self._floor:
            raise TicketExpiredError(
                "cannot accept the ticket: the relay may have accepted it before; get a new one"
            )

    def use(self, ticket_id: str, issued_at: datetime) -> None:
        """Remember the ticket; TicketUsedError when it is known."""
        if ticket_id in self._issued:
            raise TicketUsedError("cannot accept the ticket: it was already used; get a new one")
        self._issued[ticket_id] = issued_at
        if len(self._issued) > self._capacity:
            _, forgotten = self._issued.popitem(last=False)
            self._floor = max(self._floor, forgotten + timedelta(seconds=1))


class Access:
    """Decides who may open what, with the newest rights.

    `online_s` gives for how long a robot has been here that may have come from another cell, where its tickets may be
    used already; None: from none.
    """

    def __init__(
        self,
        settings: RelaySettings,
        credentials: Credentials,
        snapshot: Callable[[], Snapshot],
        online_s: Callable[[int], float | None],
        clock: Callable[[], datetime] = utc_now,
    ) -> None:
        tickets = settings.tickets
        self._signer = TicketSigner(tickets.key, tickets.ttl_s)
        self._recorder_signer = TicketSigner(tickets.key, tickets.ttl_s, RECORDER_SALT)
        self._credentials = credentials
        self._snapshot = snapshot
        self._allowed_origins = frozenset(settings.allowed_origins)
        self._clock = clock
        self._online_s = online_s
        self._used = UsedTickets(clock())

    def for_rosbridge(self, request: Request, name: str) -> Permit:
        """Let a ticket open its one WebSocket to robot `name`, and use it up."""
        _check_name(name)
        self.check_origin(request)
        if request.ticket is None:
            raise TicketMissingError(
                f"cannot open robot {name}: the request has no ticket; get one by POST /api/v1/tickets, for ?ticket="
            )
        if (permit := self._permit_of_recorder(request.ticket, name, "observe")) is not None:
            return permit
        ticket, issued_at = self._verified(request.ticket)
        if ticket.mode == "app":
            raise TicketForeignError(f"cannot open robot {name}: the ticket is for an app")
        permit = self._permit_of_ticket(ticket, issued_at, name, ticket.mode)
        self._use(ticket, issued_at, permit.robot)
        return permit

    def for_app(self, request: Request, name: str) -> Ticket:
        """Let a ticket open its one WebSocket for its user's app `name`, and use it up."""
        self.check_origin(request)
        if request.ticket is None:
            raise TicketMissingError(
                f"cannot connect app {name}: it has no ticket; get one by POST /api/v1/tickets/app, for ?ticket="
            )
        ticket, issued_at = self._verified(request.ticket)
        if ticket.mode != "app" or ticket.robot != name:
            raise TicketForeignError(f"cannot connect app {name}: the ticket is for something else")
        self._used.use(ticket.id, issued_at)
        return ticket

    async def for_video(self, request: Request, name: str) -> Permit:
        """Let a ticket, login or token see the video of robot `name`."""
        _check_name(name)
        self.check_origin(request)
        if request.ticket is not None:
            ticket, issued_at = self._verified(request.ticket)
            return self._permit_of_ticket(ticket, issued_at, name, "video")
        asker = await self.asker(request)
        robot = self.visible_robot(asker.user, name, request)
        may_drive = permits(self._snapshot().level(asker.user.id, robot.id), "drive")
        return Permit(asker.user, robot, "video", asker.credential, may_drive=may_drive)

    def check_recorder(self, text: str | None) -> None:
        """Let the stack's recorder through with a ticket of its own, and use it up; refuse all others."""
        if text is None or self._ticket_of_recorder(text) is None:
            raise TicketForgedError(
                "cannot accept the ticket: this stack's recorder did not sign it"
            )

    async def for_frames(self, request: Request, name: str) -> Permit:
        """Let a ticket open one connection to the frames of robot `name`, and use it up; or a login or token."""
        if request.ticket is not None:
            permit_of_recorder = self._permit_of_recorder(request.ticket, name, "video")
            if permit_of_recorder is not None:
                return permit_of_recorder
        permit = await self.for_video(request, name)
        if request.ticket is not None:
            ticket, issued_at = self._verified(request.ticket)
            self._use(ticket, issued_at, permit.robot)
        return permit

    async def for_topic(self, request: Request, name: str) -> Permit:
        """Let a login or token read topics of robot `name`."""
        asker = await self.for_events(request)
        robot = self.visible_robot(asker.user, name, request)
        return Permit(asker.user, robot, "observe", asker.credential)

    async def for_service(self, request: Request, name: str) -> Permit:
        """Let a login or token call services of robot `name`, as a driver if it may drive."""
        asker = await self.for_change(request)
        robot = self.visible_robot(asker.user, name, request)
        level = self._snapshot().level(asker.user.id, robot.id)
        if level is None or not permits(level, "drive"):
            return Permit(asker.user, robot, "observe", asker.credential)
        return Permit(asker.user, robot, "drive", asker.credential, level, may_drive=True)

    async def for_events(self, request: Request) -> AuthenticatedUser:
        """Let a login or token follow the fleet."""
        self.check_origin(request)
        self._snapshot()
        return await self.asker(request)

    async def for_change(self, request: Request) -> AuthenticatedUser:
        """Let a token change something, or a login that a page of this site uses.

        A page of another site can send neither an Origin of ours nor a header of its own choice.
        """
        self.check_origin(request)
        self._snapshot()
        asker = await self.asker(request)
        if asker.credential.kind == "login" and request.origin is None and not request.csrf_header:
            raise CsrfRefusedError(
                "cannot change anything: send the header X-CSRFToken with a login"
            )
        return asker

    async def asker(self, request: Request) -> AuthenticatedUser:
        """Return who asks by token or login; LoginMissingError or TokenInvalidError when nobody is known.

        A page of another site shows a token: a login that its browser adds is not its word.
        """
        if request.authorization is not None:
            return await self._asker_by_token(request)
        is_ours = request.origin is None or _same_host(request.origin, request.host)
        asker = await self._asker(request, "login", (request.login or "") if is_ours else "")
        if asker is None:
            raise LoginMissingError("cannot identify the caller: log in first")
        return asker

    async def is_vouched_for(self, request: Request) -> bool:
        """Return whether this site signed the ticket, or the login or token is somebody's.

        Whether it opens anything is for the cell that has the robot. While the database is away that one may know more.
        """
        try:
            if request.ticket is None:
                await self.asker(request)
            else:
                self._signer.verify(request.ticket)
        except (StoreUnavailableError, TicketExpiredError):
            return True
        except (
            LoginMissingError,
            ThrottledError,
            TicketForgedError,
            TicketMalformedError,
            TokenInvalidError,
        ):
            return False
        return True

    def observer_ticket(self, request: Request) -> Ticket | None:
        """Return the ticket that this site signed for somebody who observes; None: there is none, or it is too old."""
        try:
            ticket, _ = self._signer.verify(request.ticket or "")
        except (TicketExpiredError, TicketForgedError, TicketMalformedError):
            return None
        return ticket if ticket.mode == "observe" else None

    def check_origin(self, request: Request) -> None:
        """Refuse pages of other sites; programs send no Origin."""
        origin = request.origin
        if origin is None or origin in self._allowed_origins:
            return
        if not _same_host(origin, request.host):
            raise OriginRefusedError(
                f"cannot serve a page of {origin[:100]}: only this site's own pages and those in "
                "ALLOWED_ORIGINS may ask"
            )

    async def _asker_by_token(self, request: Request) -> AuthenticatedUser:
        scheme, _, token = (request.authorization or "").partition(" ")
        asker = None
        if scheme.lower() == "bearer":
            asker = await self._asker(request, "token", token.strip())
        if asker is None:
            raise TokenInvalidError(
                "cannot identify the caller: the token is unknown or has expired"
            )
        return asker

    async def _asker(
        self, request: Request, kind: CredentialKind, text: str
    ) -> AuthenticatedUser | None:
        if not 0 < len(text) <= MAX_CREDENTIAL_LENGTH:
            return None
        credential = credential_of(kind, text)
        user = await self._credentials.user_of(credential, request.address, stops=request.stops)
        return None if user is None else AuthenticatedUser(user, credential)

    def _verified(self, text: str) -> tuple[Ticket, datetime]:
        ticket, issued_at = self._signer.verify(text)
        self._used.refuse_too_old(issued_at, self._clock())
        return ticket, issued_at

    def _use(self, ticket: Ticket, issued_at: datetime, robot: RelayRobot) -> None:
        online_s = self._online_s(robot.id)
        if online_s is not None:
            # Counted back from now, as the clock may have been set since. A signature's timestamp has whole seconds.
            connected_at = self._clock() - timedelta(seconds=online_s)
            if issued_at < connected_at.replace(microsecond=0):
                raise TicketExpiredError(
                    "cannot accept the ticket: the robot has connected elsewhere since; get a new one"
                )
        self._used.use(ticket.id, issued_at)

    def _permit_of_recorder(self, text: str, name: str, use: Use) -> Permit | None:
        """Return what a ticket of the stack's recorder permits, and use it up; None: it is none."""
        ticket = self._ticket_of_recorder(text)
        if ticket is None:
            return None
        robot = self.visible_robot(RECORDER, name)
        if ticket.robot_id != robot.id:
            raise TicketForeignError(f"cannot open robot {name}: the ticket is for another robot")
        return Permit(RECORDER, robot, use, None)

    def _ticket_of_recorder(self, text: str) -> Ticket | None:
        """Read a ticket of the stack's recorder, and use it up; None: it is none."""
        try:
            ticket, issued_at = self._recorder_signer.verify(text)
        except (TicketForgedError, TicketMalformedError):
            return None
        self._used.refuse_too_old(issued_at, self._clock())
        self._used.use(ticket.id, issued_at)
        return ticket

    def _permit_of_ticket(self, ticket: Ticket, issued_at: datetime, name: str, use: Use) -> Permit:
        user = RelayUser(ticket.user_id, ticket.user)
        robot = self.visible_robot(user, name)
        if ticket.remembered:
            is_for_it = ticket.robot == name and ticket.mac in {None, robot.mac}
        else:
            is_for_it = ticket.robot_id == robot.id
        if not is_for_it:
            raise TicketForeignError(f"cannot open robot {name}: the ticket is for another robot")
        granted = self._snapshot().level(user.id, robot.id)
        if granted is None or not permits(granted, use):
            raise GrantMissingError(f"cannot drive robot {name}: your grant is to observe only")
        credential = credential_in(ticket)
        if not ticket.remembered:
            age = self._clock() - issued_at
            self._credentials.note_signed(credential, user, age.total_seconds())
        elif not self._credentials.held_lately(credential):
            raise StoreUnavailableError(
                f"cannot open robot {name}: the database does not answer; try again shortly"
            )
        level = granted if use == "drive" else "observe"
        return Permit(user, robot, use, credential, level, may_drive=permits(granted, "drive"))

    def visible_robot(
        self, user: RelayUser, name: str, request: Request | None = None
    ) -> RelayRobot:
        """Return the robot that a request means; RobotUnknownError when there is none for this user.

        A stop goes by its MAC, whatever the robot's name is; nothing else goes to another robot than that.
        """
        _check_name(name)
        snapshot, mac = self._snapshot(), None if request is None else request.mac
        is_stop = request is not None and request.stops
        robot = snapshot.meant(name, mac) if is_stop else snapshot.by_name.get(name)
        if robot is None or snapshot.level(user.id, robot.id) is None:
            raise RobotUnknownError(f"cannot open robot {name}: there is no such robot for you")
        if not is_stop and mac not in {None, robot.mac}:
            raise RobotUnknownError(f"cannot open robot {name}: another robot has this name now")
        return robot


def request_of(request: web.Request, *, stops: bool = False) -> Request:
    """Pick out of an HTTP request what says who asks, and which robot is meant; no stop is refused for its MAC."""
    headers, mac = request.headers, request.query.get("mac")
    if mac is not None:
        mac = mac_of(mac) if stops else normalise_mac(mac)
    return Request(
        host=headers.get("Host", ""),
        origin=headers.get("Origin"),
        ticket=request.query.get("ticket"),
        login=request.cookies.get(LOGIN_COOKIE),
        authorization=headers.get("Authorization"),
        address=headers.get("X-Forwarded-For", ""),
        csrf_header=headers.get("X-CSRFToken", ""),
        mac=mac,
        stops=stops,
    )


def credential_in(ticket: Ticket) -> Credential:
    """Return the login or token that asked for a ticket."""
    return Credential(ticket.credential, bytes.fromhex(ticket.credential_sha256))


def _check_name(name: str) -> None:
    """Refuse what is no robot's name, before it is in any sentence or log."""
    if not ROBOT_NAME.fullmatch(name):
        raise RobotUnknownError("cannot open the robot: a robot's name has a-z, 0-9 and - only")


def _same_host(origin: str, host: str) -> bool:
    # Not http: whoever is between could write such a page, and this site serves none.
    scheme, _, netloc = origin.partition("://")
    own = _host_and_port(host)
    return scheme == "https" and own is not None and own == _host_and_port(netloc)


def _host_and_port(netloc: str) -> tuple[str, int] | None:
    try:
        parts = urlsplit(f"//{netloc}")
        port = parts.port
    except ValueError:
        return None
    if not parts.hostname or parts.netloc != netloc:
        return None
    return parts.hostname, HTTPS_PORT if port is None else port


@dataclass(frozen=True)
class HandlerContext:
    """What all handlers need to let somebody through to a robot; `dialer` is the way to robots' rosbridge."""

    access: Access
    credentials: Credentials
    registry: SessionRegistry
    connections: Connections
    dialer: RobotDialer

    @contextmanager
    def counted(self, connection: Connection, credential: Credential | None) -> Iterator[None]:
        """Count a connection inside the block, and end it when its link, its right or its credential does."""
        robot = connection.robot
        on_rights_ended = partial(connection.end, close_reasons.rights_ended(robot.name))
        with (
            self.connections.joined(connection),
            nullcontext()
            if credential is None
            else self.credentials.held(credential, on_rights_ended),
            self.registry.ensure_robot(robot.id).usage.counted(),
        ):
            yield

    def counted_uplink(
        self, connection: Connection, received: ReceivedBytes
    ) -> AbstractContextManager[None]:
        """Count inside the block what rosbridge sends to a connection as a part of the robot's uplink."""
        uplink = self.registry.ensure_robot(connection.robot.id).uplink
        return uplink.counted("rosbridge", "", received, connection.user_ids)

    async def check_credential(self, credential: Credential | None, robot: RelayRobot) -> None:
        """Let nobody drive without a login or token, or with one that has ended since.

        `counted` alone would let somebody a second later.

        Raises ConnectionClosedError.
        """
        try:
            holds = credential is not None and await self.credentials.holds(credential)
        except StoreUnavailableError as problem:
            raise ConnectionClosedError(close_reasons.lease_unavailable(robot.name)) from problem
        if not holds:
            raise ConnectionClosedError(close_reasons.rights_ended(robot.name))

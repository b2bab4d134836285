"""/api/v1/tickets: permissions to open one WebSocket, which the relay verifies by itself."""

from typing import Literal

from flask import request
from msgspec import UNSET, Struct, UnsetType

from robotether_server.api import auth
from robotether_server.api.auth import Caller
from robotether_server.api.context import context
from robotether_server.api.operations import Created, operation
from robotether_server.api.recent_users import RecentUser
from robotether_server.db import cells, seen_robots
from robotether_server.db.cells import Cell
from robotether_server.db.users import User
from robotether_server.identity import normalise_mac
from robotether_server.problems import StoreUnavailableError
from robotether_server.schemas import AppName, Mac, RobotName
from robotether_server.tickets import Mode, Ticket, new_id

# What a ticket of a robot is for.
RobotMode = Literal["observe", "drive"]


class NewTicket(Struct, forbid_unknown_fields=True):
    """A new ticket. `mac`: that of the robot meant, as another one may have its name by now."""

    robot: RobotName
    mode: RobotMode
    mac: Mac | UnsetType = UNSET


class CellAddress(Struct):
    """Where a machine of the site serves pages and API."""

    host: str
    port: int


class SignedTicket(Struct):
    """A ticket, and the path of the WebSocket that it opens.

    `cell`: the machine where the robot is online; every other one passes what it gets on to that.
    """

    ticket: str
    robot: RobotName
    mode: RobotMode
    expires_in_s: int
    ros_url: str
    cell: CellAddress | UnsetType = UNSET


class NewAppTicket(Struct, forbid_unknown_fields=True):
    """A new ticket for a web app."""

    app: AppName


class AppTicket(Struct):
    """A ticket, and the path of the WebSocket with which an app connects."""

    ticket: str
    app: AppName
    expires_in_s: int
    ros_url: str


def create_without_database(body: NewTicket) -> Created[SignedTicket]:
    """Create a ticket for a user whom the database confirmed lately; the relay knows the robot and the grant."""
    user = context().recent_users.find(auth.credential_of(request))
    if user is None:
        raise StoreUnavailableError(
            f"cannot open robot {body.robot}: the database does not answer; try again shortly"
        )
    auth.protect_login(request)
    return _sign(user, body, robot_id=None), 201


@operation(
    "POST",
    "/tickets",
    "user",
    any_type=True,
    problems=(404,),
    without_database=create_without_database,
)
def create_ticket(caller: Caller, body: NewTicket) -> Created[SignedTicket]:
    """Create a ticket, which opens one WebSocket to one robot."""
    mac = None if body.mac is UNSET else body.mac
    seen = seen_robots.require(caller.tx, caller.user, body.robot, body.mode, mac=mac)
    cell = _address_of(cells.find_of_robot(caller.tx, seen.robot.id))
    return _sign(caller.user, body, seen.robot.id, cell), 201


@operation("POST", "/tickets/app", "user", any_type=True, renews_login=False)
def create_app_ticket(caller: Caller, body: NewAppTicket) -> Created[AppTicket]:
    """Create a ticket, with which an app of the caller's connects once, as an end of the caller's routes."""
    text = _text(caller.user, None, body.app, "app")
    url = f"/apps/{body.app}/ros?ticket={text}"
    return AppTicket(text, body.app, context().signer.ttl_s, url), 201


def _sign(
    user: User | RecentUser,
    body: NewTicket,
    robot_id: int | None,
    cell: CellAddress | UnsetType = UNSET,
) -> SignedTicket:
    name, mode = body.robot, body.mode
    mac = normalise_mac(body.mac) if robot_id is None and body.mac is not UNSET else None
    text = _text(user, robot_id, name, mode, remembered=robot_id is None, mac=mac)
    url = f"/robots/{name}/ros?ticket={text}"
    return SignedTicket(text, name, mode, context().signer.ttl_s, url, cell)


def _text(
    user: User | RecentUser,
    robot_id: int | None,
    name: str,
    mode: Mode,
    *,
    remembered: bool = False,
    mac: str | None = None,
) -> str:
    who, by = (user.id, user.name), auth.credential_of(request)
    return context().signer.sign(
        Ticket(new_id(), *who, robot_id, name, mode, *by, remembered=remembered, mac=mac)
    )


def _address_of(cell: Cell | None) -> CellAddress | UnsetType:
    if cell is None or not cell.is_listed or cell.host is None:
        return UNSET
    return CellAddress(cell.host, cell.https_port)

"""/api/v1/tickets: permissions to open one WebSocket, which the relay verifies by itself."""

from flask import request
from msgspec import UNSET, Struct, UnsetType

from robotether_server.api import auth
from robotether_server.api.auth import Caller
from robotether_server.api.context import context
from robotether_server.api.operations import Created, operation
from robotether_server.api.recent_rights import RecentRight
from robotether_server.db import cells, grants, seen_robots
from robotether_server.db.cells import Cell
from robotether_server.problems import GrantMissing, RobotUnknown, StoreUnavailable
from robotether_server.schemas import RobotName
from robotether_server.tickets import Mode, Ticket, new_id


class NewTicket(Struct, forbid_unknown_fields=True):
    """A new ticket."""

    robot: RobotName
    mode: Mode


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
    mode: Mode
    expires_in_s: int
    ros_url: str
    cell: CellAddress | UnsetType = UNSET


def create_lately_allowed(body: NewTicket) -> Created[SignedTicket]:
    """Create a ticket while the database is away, by a right that it confirmed lately."""
    right = context().recent_rights.find(auth.credential_of(request), body.robot)
    if right is None:
        raise StoreUnavailable(
            f"cannot open robot {body.robot}: the database does not answer; try again shortly"
        )
    auth.protect_login(request)
    return _signed(right, body, UNSET, remembered=True), 201


@operation(
    "POST",
    "/tickets",
    "user",
    any_type=True,
    problems=(404,),
    without_database=create_lately_allowed,
)
def create_ticket(caller: Caller, body: NewTicket) -> Created[SignedTicket]:
    """Create a ticket, which opens one WebSocket to one robot."""
    name, user, recent_rights = body.robot, caller.user, context().recent_rights
    credential = auth.credential_of(request)
    seen = seen_robots.find_seen(caller.tx, user, name)
    if seen is None:
        recent_rights.forget(credential, name)
        raise RobotUnknown(f"cannot open robot {name}: there is none of that name that you may see")
    right = RecentRight(user.id, user.name, seen.robot.id, seen.level)
    recent_rights.note(credential, name, right)
    cell = _address_of(cells.find_of_robot(caller.tx, seen.robot.id))
    return _signed(right, body, cell), 201


def _signed(
    right: RecentRight,
    body: NewTicket,
    cell: CellAddress | UnsetType,
    *,
    remembered: bool = False,
) -> SignedTicket:
    name, mode, signer = body.robot, body.mode, context().signer
    if not grants.includes(right.level, mode):
        raise GrantMissing(f"cannot open robot {name} to {mode}: your grant is {right.level}")
    kind, sha256 = auth.credential_of(request)
    user = right.user_id, right.user
    text = signer.sign(
        Ticket(new_id(), *user, right.robot_id, name, mode, kind, sha256, remembered=remembered)
    )
    url = f"/robots/{name}/ros?ticket={text}"
    return SignedTicket(text, name, mode, signer.ttl_s, url, cell)


def _address_of(cell: Cell | None) -> CellAddress | UnsetType:
    if cell is None or not cell.is_listed or cell.host is None:
        return UNSET
    return CellAddress(cell.host, cell.https_port)

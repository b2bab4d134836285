"""/api/v1/tickets: permissions to open one WebSocket, which the relay verifies by itself."""

from flask import request
from msgspec import UNSET, Struct, UnsetType

from robotether_server.api import auth
from robotether_server.api.auth import Caller
from robotether_server.api.context import context
from robotether_server.api.operations import Created, operation
from robotether_server.db import cells, grants, seen_robots
from robotether_server.db.cells import Cell
from robotether_server.problems import GrantMissing, RobotUnknown
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


@operation("POST", "/tickets", "user", any_type=True, problems=(404,))
def create_ticket(caller: Caller, body: NewTicket) -> Created[SignedTicket]:
    """Create a ticket, which opens one WebSocket to one robot."""
    name, mode, user = body.robot, body.mode, caller.user
    seen = seen_robots.find_seen(caller.tx, user, name)
    if seen is None:
        raise RobotUnknown(f"cannot open robot {name}: there is none of that name that you may see")
    if not grants.includes(seen.level, mode):
        raise GrantMissing(f"cannot open robot {name} to {mode}: your grant is {seen.level}")
    signer = context().signer
    kind, sha256 = auth.credential_of(request)
    text = signer.sign(
        Ticket(new_id(), user.id, user.name, seen.robot.id, name, mode, kind, sha256)
    )
    url = f"/robots/{name}/ros?ticket={text}"
    cell = _address_of(cells.find_of_robot(caller.tx, seen.robot.id))
    return SignedTicket(text, name, mode, signer.ttl_s, url, cell), 201


def _address_of(cell: Cell | None) -> CellAddress | UnsetType:
    if cell is None or not cell.is_listed or cell.host is None:
        return UNSET
    return CellAddress(cell.host, cell.https_port)

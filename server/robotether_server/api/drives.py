"""/api/v1/drives: records of who drove which robot; the user's own, of robots that the user manages, all for admins."""

from dataclasses import fields as members_of
from functools import partial
from typing import Annotated

from flask import Response
from msgspec import UNSET, Meta, Struct, UnsetType

from robotether_server.api import exports
from robotether_server.api.auth import Caller
from robotether_server.api.exports import USUAL_LIMIT, ListQuery, RobotMac
from robotether_server.api.operations import operation, respond
from robotether_server.db import drives
from robotether_server.db.drives import Drive, DriveSearch
from robotether_server.identity import normalise_mac
from robotether_server.schemas import Label

MAX_FENCE = 2**64 - 1
COLUMNS = tuple(member.name for member in members_of(Drive))
download = partial(exports.download, columns=COLUMNS, filename="robotether-drives")


class DriveQuery(ListQuery):
    """Filters of the drives."""

    user: Label | UnsetType = UNSET
    mac: RobotMac | UnsetType = UNSET
    fence: (
        Annotated[
            int,
            Meta(
                ge=0,
                description="The number of the lease. With the robot's MAC it names one drive",
                extra_json_schema={"maximum": MAX_FENCE},
                extra={"most": MAX_FENCE},
            ),
        ]
        | UnsetType
    ) = UNSET


class DriveList(Struct):
    """Drives, newest first; with `format` all that match, as a file."""

    drives: list[Drive]


@operation("GET", "/drives", "user", tag="robots", texts=exports.FILE_TYPES)
def list_drives(caller: Caller, query: DriveQuery) -> DriveList | Response:
    """List drives, newest first.

    The caller's own and those of robots that the caller manages; for admins all. Distance, turn and speeds
    are those commanded. A drive that never moved the robot is listed only if `fence` asks for it. A robot that was
    renamed is found by its new name and by that of the drive.
    """
    search = DriveSearch(
        robot=query.robot or None,
        mac=None if query.mac is UNSET else normalise_mac(query.mac),
        user=query.user or None,
        since=query.since or None,
        until=query.until or None,
        fence=None if query.fence is UNSET else query.fence,
    )
    find = partial(drives.find, search=search)
    before = query.before or None
    if query.format:
        return download(find, query.format, before=before, limit=query.limit or None)
    return DriveList(find(caller.tx, caller.user, before=before, limit=query.limit or USUAL_LIMIT))


@operation("GET", "/drives/<int:drive_id>", "user", tag="robots")
def get_drive(caller: Caller, drive_id: int) -> Drive | Response:
    """Get one drive, as a file."""
    drive = drives.get(caller.tx, caller.user, drive_id)
    answer = respond(drive)
    name = f"robotether-drive-{drive.id}.json"
    answer.headers["Content-Disposition"] = f'attachment; filename="{name}"'
    return answer

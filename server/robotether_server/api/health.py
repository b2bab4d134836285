"""/api/v1/health: how the site's parts are now, and what Prometheus has kept of its numbers; for admins."""

from typing import Literal

from msgspec import UNSET, Struct, UnsetType

from robotether_server.api.auth import Caller
from robotether_server.api.context import context
from robotether_server.api.operations import operation
from robotether_server.db import robots
from robotether_server.schemas import RobotName
from robotether_server.services.health import SiteHealth, read_health
from robotether_server.services.history import SPANS, History


class HistoryQuery(Struct, forbid_unknown_fields=True):
    """The time, and the robot; without one: all."""

    range: Literal["hour", "day", "week"] = "hour"
    robot: RobotName | UnsetType = UNSET


@operation("GET", "/health", "admin", renews_login=False)
def get_health(caller: Caller) -> SiteHealth:
    """Get how each part of the site is now, and what to do."""
    app = context()
    return read_health(
        caller.tx,
        app.site_certificates,
        app.ssh_probe,
        app.prometheus,
        backup_record=app.backup_record,
        database_record=app.database_record,
    )


@operation("GET", "/health/history", "admin", renews_login=False, problems=(404, 503))
def get_history(caller: Caller, query: HistoryQuery) -> History:
    """Get the last hour, day or week of a robot, or of all.

    It needs the profile `metrics`. A value is null where it is not known.
    """
    robot_id = robots.get(caller.tx, query.robot).id if query.robot else None
    return context().prometheus.history(SPANS[query.range], robot_id)

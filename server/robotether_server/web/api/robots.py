"""/api/v1/robots: the robots that a user may see."""

from flask import Response, jsonify, request

from robotether_server.store import robots
from robotether_server.store.robots import SeenRobot
from robotether_server.web import access
from robotether_server.web.api.blueprint import blueprint
from robotether_server.web.pages import moment_text
from robotether_server.web.parts import parts


@blueprint.get("/robots")
def list_robots() -> Response:
    """List the robots that the user may see."""
    with parts().database.transaction() as tx:
        seen = robots.list_seen(tx, access.api_user(tx, request))
    return jsonify({"robots": [_robot(robot) for robot in seen]})


def _robot(seen: SeenRobot) -> dict[str, object]:
    return {
        "name": seen.robot.name,
        "mac": seen.robot.mac,
        "state": seen.robot.state,
        "online": seen.online,
        "since": moment_text(seen.since),
        "level": seen.level,
        "ros_port": seen.robot.ros_port,
        "video_port": seen.robot.video_port,
    }

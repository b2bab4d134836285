"""Grants, given and taken from a robot's page and from a user's; both forms are of the same fields."""

from collections.abc import Callable

from flask import Blueprint, request
from werkzeug.wrappers import Response as AnyResponse

from robotether_server.administration import grants
from robotether_server.problems import Problem, RecordMissing
from robotether_server.store.grants import LEVELS
from robotether_server.web import deeds, forms, visitors
from robotether_server.web.admin import robot_page, users
from robotether_server.web.deeds import METHODS, Deed
from robotether_server.web.parts import parts

blueprint = Blueprint("grants", __name__)

LONGEST_NAME = 63
PageAnswer = AnyResponse | str | tuple[str, int]


@blueprint.route("/robots/<name>/grants", methods=METHODS)
def of_robot(name: str) -> PageAnswer:
    """Let a user do something with this robot."""
    return _give(robot_page.render, name, robot_page.page_of(name))


@blueprint.route("/users/<name>/grants", methods=METHODS)
def of_user(name: str) -> PageAnswer:
    """Let this user do something with a robot."""
    return _give(users.render, name, users.page_of(name))


@blueprint.route("/grants/<user>/<robot>/take", methods=METHODS)
def take(user: str, robot: str) -> AnyResponse:
    """Take a grant away."""
    level = _level(user, robot)
    is_of_user = request.args.get("from") == "user"
    deed = Deed(
        title=f"Take the grant of {user} for robot {robot} away?",
        effects=(
            f"{user}, who may {level} it now, does not see robot {robot} any more.",
            f"What {user} has open to it is cut within 2 seconds; a robot that {user} drives stops by itself.",
        ),
        undo=f"Give {user} the grant {level} for robot {robot} again.",
        button="Take away",
        done=f"User {user} has no grant for robot {robot} any more.",
        back=users.page_of(user) if is_of_user else robot_page.page_of(robot),
    )
    return deeds.run(deed, lambda tx, source: grants.revoke(tx, source, user, robot))


def _give(render: Callable[[str, Problem | None], str], name: str, back: str) -> PageAnswer:
    """Give the grant of the form, and show the page that the form stands on again."""
    if request.method == "GET":
        return render(name, None)
    try:
        user = forms.text("user", "User", LONGEST_NAME)
        robot = forms.text("robot", "Robot", LONGEST_NAME)
        level = forms.choice("level", "Level", LEVELS)
        with parts().database.transaction() as tx:
            grants.grant(tx, visitors.source(), user, robot, level)
    except Problem as problem:
        return render(name, problem), problem.status
    return deeds.go_on(back, f"User {user} may {level} robot {robot}.")


def _level(user: str, robot: str) -> str:
    with parts().database.transaction() as tx:
        for grant in grants.list_all(tx):
            if (grant.user, grant.robot) == (user, robot):
                return grant.level
    raise RecordMissing(f"cannot take the grant away: user {user} has none for robot {robot}")

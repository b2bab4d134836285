"""/admin/groups: groups of users, whose grants every member has; /admin/groups/NAME: one of them."""

from flask import Blueprint, render_template, request
from werkzeug.wrappers import Response as AnyResponse

from robotether_server.api.context import context
from robotether_server.db import grants, users
from robotether_server.db.grants import LEVELS
from robotether_server.problems import Problem
from robotether_server.schemas import MAX_NAME_LENGTH
from robotether_server.services import grants as grant_service
from robotether_server.web import confirmation, current_user, forms
from robotether_server.web.admin import grant_lists
from robotether_server.web.confirmation import METHODS, ConfirmedAction

blueprint = Blueprint("groups", __name__, url_prefix="/groups")

PageAnswer = AnyResponse | str | tuple[str, int]


@blueprint.get("")
def show_all() -> str:
    """Show every group."""
    return _list()


@blueprint.post("")
def add() -> PageAnswer:
    """Add a group."""
    try:
        name = forms.text("name", "Name", MAX_NAME_LENGTH)
        with context().database.transaction() as tx:
            grant_service.add_group(tx, current_user.source(), name)
    except Problem as problem:
        return _list(problem), problem.status
    return confirmation.go_on(page_of(name), f"Group {name} is added. Add users and grants to it.")


@blueprint.get("/<name>")
def show(name: str) -> str:
    """Show one group."""
    return render(name)


@blueprint.route("/<name>/members", methods=METHODS)
def add_member(name: str) -> PageAnswer:
    """Make a user a member."""
    if request.method == "GET":
        return render(name)
    try:
        user = forms.text("user", "User", MAX_NAME_LENGTH)
        with context().database.transaction() as tx:
            grant_service.add_member(tx, current_user.source(), name, user)
    except Problem as problem:
        return render(name, problem), problem.status
    return confirmation.go_on(page_of(name), f"User {user} is a member of group {name}.")


@blueprint.route("/<name>/members/<user>/remove", methods=METHODS)
def remove_member(name: str, user: str) -> AnyResponse:
    """End a membership."""
    action = ConfirmedAction(
        title=f"Remove {user} from group {name}?",
        effects=(
            f"{user} loses what only the grants of group {name} allow; "
            "connections that need them are cut within 2 seconds.",
        ),
        undo=f"Add {user} again.",
        button="Remove",
        done=f"User {user} is no longer a member of group {name}.",
        back=page_of(name),
    )
    return confirmation.run(
        action, lambda tx, source: grant_service.remove_member(tx, source, name, user)
    )


@blueprint.route("/<name>/remove", methods=METHODS)
def remove(name: str) -> AnyResponse:
    """Remove a group."""
    with context().database.transaction() as tx:
        found = grants.get_group(tx, name)
    action = ConfirmedAction(
        title=f"Remove group {name}?",
        effects=(
            "Its grants are removed with it: what only these allow ends within 2 seconds. "
            f"Members: {', '.join(found.members) or 'none'}.",
            "The users stay.",
        ),
        undo="A removed group cannot be restored; add it again, with members and grants.",
        button="Remove",
        done=f"Group {name} is removed.",
        back=page_of(name),
        onward="/admin/groups",
    )
    return confirmation.run(action, lambda tx, source: grant_service.remove_group(tx, source, name))


def render(name: str, problem: Problem | None = None) -> str:
    """Return the page of a group, with the problem of one of its forms; raise RecordMissing."""
    with context().database.transaction() as tx:
        group = grants.get_group(tx, name)
        return render_template(
            "admin/group.html",
            group=group,
            others=[one.name for one in users.list_all(tx) if one.name not in group.members],
            grants=grant_lists.of_group(tx, name),
            choices=grant_lists.scopes(tx),
            levels=LEVELS,
            problem=problem,
            values=request.form,
        )


def page_of(name: str) -> str:
    """Return the path of a group's page."""
    return f"/admin/groups/{name}"


def _list(problem: Problem | None = None) -> str:
    with context().database.transaction() as tx:
        found = grants.list_groups(tx)
    return render_template("admin/groups.html", groups=found, problem=problem, values=request.form)

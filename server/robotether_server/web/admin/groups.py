"""/admin/groups: groups of users, whose grants every member has; /admin/groups/NAME: one of them."""

from flask import Blueprint, render_template, request

from robotether_server.api.context import context
from robotether_server.db import Transaction, join_tokens, users
from robotether_server.db import grants as db_grants
from robotether_server.db.audit import Source
from robotether_server.db.grants import LEVELS
from robotether_server.db.join_tokens import Place
from robotether_server.problems import RobotetherError
from robotether_server.schemas import MAX_NAME_LENGTH
from robotether_server.services import grants as grant_service
from robotether_server.web import confirmation, forms
from robotether_server.web.admin import grants
from robotether_server.web.confirmation import ConfirmedAction, Words
from robotether_server.web.forms import Saved, form

blueprint = Blueprint("groups", __name__, url_prefix="/groups")


def show_all(problem: RobotetherError | None = None) -> str:
    """Show every group."""
    with context().database.transaction() as tx:
        groups = db_grants.list_groups(tx)
    return render_template("admin/groups.html", groups=groups, problem=problem, values=request.form)


@form(blueprint, "", show_all)
def add(tx: Transaction, source: Source) -> Saved:
    """Add a group."""
    name = forms.text("name", "Name", MAX_NAME_LENGTH)
    grant_service.add_group(tx, source, name)
    return page_of(name), f"Group {name} is added. Add users and grants to it."


@blueprint.get("/<name>")
def show(name: str, problem: RobotetherError | None = None) -> str:
    """Show one group, with the problem of one of its forms."""
    with context().database.transaction() as tx:
        group = db_grants.get_group(tx, name)
        return render_template(
            "admin/group.html",
            group=group,
            others=[
                (user.name, user.name)
                for user in users.list_all(tx)
                if user.name not in group.members
            ],
            grants=grants.of_group(tx, name),
            choices=grants.scopes(tx),
            levels=LEVELS,
            problem=problem,
            values=request.form,
        )


@form(blueprint, "/<name>/members", show)
def add_member(tx: Transaction, source: Source, name: str) -> Saved:
    """Make a user a member."""
    user = forms.text("user", "User", MAX_NAME_LENGTH)
    grant_service.add_member(tx, source, name, user)
    return page_of(name), f"User {user} is a member of group {name}."


def page_of(name: str) -> str:
    """Return the path of a group's page."""
    return f"/admin/groups/{name}"


def _words(name: str, user: str = "") -> Words:
    with context().database.transaction() as tx:
        group = db_grants.get_group(tx, name)
        tokens = ", ".join(join_tokens.names_for(tx, Place(group=name)))
    return {
        "name": name,
        "user": user,
        "members": ", ".join(group.members) or "none",
        "tokens": tokens
        and f"Robots that join with these tokens will be given to no group: {tokens}.",
    }


grants.register_form(blueprint, "/<name>/grants", show, page_of)
confirmation.register(
    blueprint,
    "/admin/groups/{name}",
    _words,
    ConfirmedAction(
        path="/<name>/members/<user>/remove",
        title="Remove {user} from group {name}?",
        effects=(
            "{user} loses what only the grants of group {name} allow; "
            "connections that need them are cut within 2 seconds.",
        ),
        undo="Add {user} again.",
        button="Remove",
        done="User {user} is no longer a member of group {name}.",
        do=grant_service.remove_member,
    ),
    ConfirmedAction(
        path="/<name>/remove",
        title="Remove group {name}?",
        effects=(
            "Its grants are removed with it: what only these allow ends within 2 seconds. "
            "Members: {members}.",
            "The users stay.",
            "{tokens}",
        ),
        undo="A removed group cannot be restored; add it again, with members and grants.",
        button="Remove",
        done="Group {name} is removed.",
        do=grant_service.remove_group,
        onward="/admin/groups",
    ),
)

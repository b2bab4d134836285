"""Grants on the pages of robots, users, groups and sites: which each shows, and the forms to give and remove them."""

import datetime as dt
import re
from collections.abc import Callable

from flask import Blueprint, request
from markupsafe import Markup

from robotether_server import times
from robotether_server.api.context import context
from robotether_server.db import Transaction, seen_robots, users
from robotether_server.db import grants as db_grants
from robotether_server.db.audit import Source
from robotether_server.db.grants import GROUPS, LEVELS, SITES, Grant
from robotether_server.db.robots import RobotRow
from robotether_server.db.users import User
from robotether_server.problems import FieldInvalidError, NotPossibleError, RecordMissingError
from robotether_server.services import grants
from robotether_server.services.grants import ALL, Grantee, Scope
from robotether_server.web import confirmation, forms
from robotether_server.web.confirmation import ConfirmedAction, Words
from robotether_server.web.forms import Saved, form
from robotether_server.web.page_texts import time_element

blueprint = Blueprint("grants", __name__)

MAX_CHOICE_LENGTH = 100
MAX_GRANT = 2**32 - 1
# How long a grant for several robots holds: hours, and words.
ENDS = (("", "no end"), ("1", "1 hour"), ("24", "1 day"), ("168", "7 days"))
# What a field of time sends without the page's script.
WITHOUT_ZONE = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d(:\d\d(\.\d{1,3})?)?", re.ASCII)
# What the question about a grant says of it.
TEXTS = {
    "lost": Markup(
        "The {who}, who may {level} now{end}, loses what only this grant gives for {what}."
    ),
    "cut": Markup(
        "Connections that need it are cut within 2 seconds; a robot that is driven by it stops by itself."
    ),
    "undo": Markup("Give the {who} the grant {level} for {what}{end} again."),
}
ENDED_TEXTS = {
    "lost": Markup("It no longer allows anything: {level}{end}. It is removed from the lists."),
    "cut": Markup(""),
    "undo": Markup("Give the grant again, with an end in the future."),
}
# Title, and value and words of what there is to choose from.
Choices = list[tuple[str, list[tuple[str, str]]]]


def for_robot(tx: Transaction, robot: RobotRow) -> list[Grant]:
    """Return the grants that reach a robot: its own, its site's and those for all."""
    return [
        grant
        for grant in db_grants.list_all(tx)
        if grant.all
        or grant.robot == robot.name
        or (grant.site is not None and grant.site == robot.site)
    ]


def for_site(tx: Transaction, site: str) -> list[Grant]:
    """Return the grants that reach a site: its own and those for all."""
    return [grant for grant in db_grants.list_all(tx) if grant.all or grant.site == site]


def of_user(tx: Transaction, user: User) -> list[Grant]:
    """Return the grants that a user has, alone or in a group."""
    joined = {group.name for group in GROUPS.list_all(tx) if user.name in group.members}
    return [
        grant
        for grant in db_grants.list_all(tx)
        if grant.user == user.name or grant.group in joined
    ]


def of_group(tx: Transaction, group: str) -> list[Grant]:
    """Return the grants that a group has."""
    return [grant for grant in db_grants.list_all(tx) if grant.group == group]


def holders(tx: Transaction) -> Choices:
    """Return who may be given a grant; admins need none."""
    people = [user.name for user in users.list_all(tx) if not user.is_admin]
    groups = GROUPS.names(tx)
    return [
        ("Users", [(f"user:{name}", name) for name in people]),
        ("Groups", [(f"group:{name}", f"group {name}") for name in groups]),
    ]


def scopes(tx: Transaction) -> Choices:
    """Return what a grant may be for."""
    robots = [seen.robot for seen in seen_robots.list_all(tx)]
    sites = SITES.names(tx)
    return [
        ("Robots", [(f"robot:{forms.robot_option(robot)}", robot.name) for robot in robots]),
        ("Sites", [(f"site:{name}", f"site {name}") for name in sites]),
        ("Everything", [("all", "all robots, also future ones")]),
    ]


def page_of_robot(name: str) -> str:
    """Return the path of the page with a robot's grants."""
    return f"/admin/robots/{name}/access"


def register_form(
    pages: Blueprint, path: str, page: Callable[..., str], page_of: Callable[[str], str]
) -> None:
    """Make the form for grants on the page of one thing; all are of the same fields."""

    def give(tx: Transaction, source: Source, name: str) -> Saved:
        return page_of(name), _give(tx, source)

    form(pages, path, page)(give)


def _give(tx: Transaction, source: Source) -> str:
    """Add the form's grant; return what is said of it."""
    to, scope = grantee(), chosen_scope(tx)
    if (number := forms.optional_number("grant", "Grant", 1, MAX_GRANT)) is not None:
        _check_row(db_grants.get(tx, number), scope)
    level = forms.choice("level", "May", LEVELS)
    grant, _ = grants.give(tx, source, to, scope, level, ends_at=_ends_at())
    words = f"{grant.holder_words} may {level} {grant.scope_words}"
    return Markup("{}{}.").format(words[0].upper() + words[1:], _end_words(grant.ends_at))


def _check_row(grant: Grant, scope: Scope) -> None:
    """Raise RecordMissingError if what a row names is no longer what its grant is for, NotPossibleError if it changed.

    A row sends level and end together: the one that was not pressed would undo what another admin did.
    """
    if (grant.robot or grant.site or "") != scope.name:
        raise RecordMissingError(
            f"cannot change the grant: it is for {grant.scope_words}, which has another name now; open this page anew"
        )
    present = f"{grant.level} {times.rfc3339(grant.ends_at) or ''}".strip()
    if request.form.get("was", present).strip() != present:
        raise NotPossibleError(
            "cannot change the grant: somebody else has changed it; this page shows how it is now"
        )


def _ends_at() -> dt.datetime | None:
    """Return the end: with its offset from the script of the page, or else in UTC."""
    text = forms.optional_text("ends_at", "Until", times.MAX_TEXT_LENGTH)
    if text is None:
        return None
    try:
        return times.timestamp("ends_at", f"{text}Z" if WITHOUT_ZONE.fullmatch(text) else text)
    except FieldInvalidError as error:
        raise FieldInvalidError("cannot use Until: choose a day and a time", "ends_at") from error


def grantee() -> Grantee:
    """Return the user or group of the form's field `holder`; raise FieldInvalidError."""
    kind, _, name = forms.text("holder", "Who", MAX_CHOICE_LENGTH).partition(":")
    if kind == "user" and name:
        return Grantee("user", name)
    if kind == "group" and name:
        return Grantee("group", name)
    raise FieldInvalidError("cannot use Who: choose a user or a group", "holder")


def usual_end(tx: Transaction) -> dt.datetime | None:
    """Return the end that the field `hours` chooses from ENDS; raise FieldInvalidError."""
    hours = forms.choice("hours", "Until", tuple(value for value, _ in ENDS))
    return tx.now() + dt.timedelta(hours=int(hours)) if hours else None


def chosen_scope(tx: Transaction) -> Scope:
    """Return what the form's field `scope` chooses; raise FieldInvalidError."""
    kind, _, name = forms.text("scope", "What", MAX_CHOICE_LENGTH).partition(":")
    if kind == "all" and not name:
        return ALL
    if kind == "robot" and name:
        return Scope("robot", forms.chosen_robot(tx, name))
    if kind == "site" and name:
        return Scope("site", name)
    raise FieldInvalidError("cannot use What: choose a robot, a site or all robots", "scope")


def _words(grant_id: int) -> Words:
    with context().database.transaction() as tx:
        grant = db_grants.get(tx, grant_id)
    who, what, end = grant.holder_words, grant.scope_words, _end_words(grant.ends_at)
    words = {"who": who, "what": what, "page": _page_of(grant, request.args.get("from", ""))}
    named = words | {"level": grant.level, "end": end}
    texts = ENDED_TEXTS if grant.has_ended else TEXTS
    return words | {key: text.format_map(named) for key, text in texts.items()}


def _end_words(end: dt.datetime | None) -> str:
    return Markup(" until {}").format(time_element(end)) if end else ""


def _page_of(grant: Grant, about: str) -> str:
    """Return the page that the question came from."""
    if about == "site" and grant.site is not None:
        return f"/admin/sites/{grant.site}"
    if about == "robot" and grant.robot is not None:
        return page_of_robot(grant.robot)
    if grant.group is not None:
        return f"/admin/groups/{grant.group}"
    return f"/admin/users/{grant.user}"


confirmation.register(
    blueprint,
    "{page}",
    _words,
    ConfirmedAction(
        path="/grants/<int:grant_id>/take",
        title="Remove the grant of {who} for {what}?",
        effects=("{lost}", "{cut}"),
        undo="{undo}",
        button="Remove",
        done="The {who} no longer has a grant for {what}.",
        do=grants.revoke_by_id,
    ),
)

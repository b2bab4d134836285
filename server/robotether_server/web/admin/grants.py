"""Gives and removes grants from the pages of robots, users, groups and sites; all forms are of the same fields."""

from collections.abc import Callable

from flask import Blueprint, request
from werkzeug.wrappers import Response as AnyResponse

from robotether_server import times
from robotether_server.api.context import context
from robotether_server.db import grants as db_grants
from robotether_server.db.grants import LEVELS, Grant
from robotether_server.problems import FieldInvalid, Problem
from robotether_server.services import grants
from robotether_server.services.grants import ALL, Grantee, Scope
from robotether_server.web import confirmation, current_user, forms
from robotether_server.web.admin import groups, robot_pages, sites, users
from robotether_server.web.confirmation import METHODS, ConfirmedAction
from robotether_server.web.page_texts import timestamp_words

blueprint = Blueprint("grants", __name__)

MAX_CHOICE_LENGTH = 80
PageAnswer = AnyResponse | str | tuple[str, int]


@blueprint.route("/robots/<name>/grants", methods=METHODS)
def of_robot(name: str) -> PageAnswer:
    """Add a grant for this robot."""
    return _give(robot_pages.render, name, robot_pages.page_of(name))


@blueprint.route("/users/<name>/grants", methods=METHODS)
def of_user(name: str) -> PageAnswer:
    """Add a grant of this user."""
    return _give(users.render, name, users.page_of(name))


@blueprint.route("/groups/<name>/grants", methods=METHODS)
def of_group(name: str) -> PageAnswer:
    """Add a grant of this group."""
    return _give(groups.render, name, groups.page_of(name))


@blueprint.route("/sites/<name>/grants", methods=METHODS)
def of_site(name: str) -> PageAnswer:
    """Add a grant for the robots of this site."""
    return _give(sites.render, name, sites.page_of(name))


@blueprint.route("/grants/<int:grant_id>/take", methods=METHODS)
def revoke(grant_id: int) -> AnyResponse:
    """Take a grant away."""
    with context().database.transaction() as tx:
        found = db_grants.get(tx, grant_id)
    who, what = found.holder_words, found.scope_words
    action = ConfirmedAction(
        title=f"Remove the grant of {who} for {what}?",
        effects=_what_is_lost(found),
        undo=_way_back(found),
        button="Remove",
        done=f"The {who} no longer has a grant for {what}.",
        back=_page_of(found, request.args.get("from", "")),
    )
    return confirmation.run(action, lambda tx, source: grants.revoke_by_id(tx, source, grant_id))


def _give(render: Callable[[str, Problem | None], str], name: str, back: str) -> PageAnswer:
    """Add the form's grant, and show the form's page again."""
    if request.method == "GET":
        return render(name, None)
    try:
        grantee, scope = _grantee(), _scope()
        level = forms.choice("level", "May", LEVELS)
        text = forms.optional_text("ends_at", "Until", times.MAX_TEXT_LENGTH)
        ends_at = times.day_or_timestamp("Until", text, is_end=True) if text else None
        with context().database.transaction() as tx:
            given, _ = grants.give(
                tx, current_user.source(), grantee, scope, level, ends_at=ends_at
            )
    except Problem as problem:
        return render(name, problem), problem.status
    words = f"{given.holder_words} may {level} {given.scope_words}{_end_words(given)}."
    return confirmation.go_on(back, words[0].upper() + words[1:])


def _grantee() -> Grantee:
    kind, _, name = forms.text("holder", "Who", MAX_CHOICE_LENGTH).partition(":")
    if kind == "user" and name:
        return Grantee("user", name)
    if kind == "group" and name:
        return Grantee("group", name)
    raise FieldInvalid("cannot use Who: choose a user or a group")


def _scope() -> Scope:
    kind, _, name = forms.text("scope", "What", MAX_CHOICE_LENGTH).partition(":")
    if kind == "all" and not name:
        return ALL
    if kind == "robot" and name:
        return Scope("robot", name)
    if kind == "site" and name:
        return Scope("site", name)
    raise FieldInvalid("cannot use What: choose a robot, a site or all robots")


def _what_is_lost(grant: Grant) -> tuple[str, ...]:
    who, what, end = grant.holder_words, grant.scope_words, _end_words(grant)
    if grant.has_ended:
        return (f"It no longer allows anything: {grant.level}{end}. It is removed from the lists.",)
    return (
        f"The {who}, who may {grant.level} now{end}, loses what only this grant gives for {what}.",
        "Connections that need it are cut within 2 seconds; a robot that is driven by it stops by itself.",
    )


def _way_back(grant: Grant) -> str:
    if grant.has_ended:
        return "Give the grant again, with an end in the future."
    end = _end_words(grant)
    return (
        f"Give the {grant.holder_words} the grant {grant.level} for {grant.scope_words}{end} again."
    )


def _end_words(grant: Grant) -> str:
    return f" until {timestamp_words(grant.ends_at)}" if grant.ends_at else ""


def _page_of(found: Grant, about: str) -> str:
    """Return the page that the question came from."""
    if about == "site" and found.site is not None:
        return sites.page_of(found.site)
    if about == "robot" and found.robot is not None:
        return robot_pages.page_of(found.robot)
    if found.group is not None:
        return groups.page_of(found.group)
    return users.page_of(found.user or "")

"""/admin/selected-users: what an admin does with all users that are ticked in the list, after one question.

Each user is changed, and written to the audit log, as alone; if one cannot be, none is.
"""

from functools import partial

from flask import Blueprint, request

from robotether_server.db import Transaction, users
from robotether_server.db.audit import Source
from robotether_server.db.grants import LEVELS
from robotether_server.schemas import MAX_NAME_LENGTH
from robotether_server.services import grants as grant_service
from robotether_server.services import users as user_service
from robotether_server.services.grants import Grantee
from robotether_server.web import current_user, forms
from robotether_server.web.admin import grants
from robotether_server.web.admin.users import USERS
from robotether_server.web.confirmation import ConfirmedAction, Words

blueprint = Blueprint("selected_users", __name__, url_prefix="/selected-users")


def _words(tx: Transaction, names: list[str]) -> Words:
    chosen = [users.get(tx, name) for name in names]
    admins = ", ".join(user.name for user in chosen if user.is_admin)
    is_among_them = current_user.get().name in names
    tokens_left = f"Join tokens of {admins} are deleted; the robots that they admitted stay."
    scope = request.values.get("scope", "")
    return {
        "name": ", ".join(names),
        "meant": " ".join(str(user.id) for user in chosen),
        "you": "You are one of them." if is_among_them else "",
        "tokens_left": tokens_left if admins else "",
        "group": request.values.get("group", ""),
        "scope": scope,
        "what": "all robots"
        if scope == "all"
        else scope.partition(" ")[0].replace("robot:", "").replace(":", " "),
    }


def _add_to_group(tx: Transaction, source: Source, name: str) -> None:
    group = forms.text("group", "Group", MAX_NAME_LENGTH)
    grant_service.add_member(tx, source, group, name)


def _give(tx: Transaction, source: Source) -> None:
    scope, level = grants.chosen_scope(tx), forms.choice("level", "May", LEVELS)
    ends_at = grants.usual_end(tx)
    for name in USERS.names(tx):
        grant_service.give(tx, source, Grantee("user", name), scope, level, ends_at=ends_at)


USERS.register(
    blueprint,
    _words,
    ConfirmedAction(
        path="/disable",
        title="Disable {count}?",
        effects=(
            "{you}",
            "Each is logged out everywhere; what they drive stops within 2 seconds.",
            "Their API tokens and SSH keys no longer work. They and the grants are kept.",
            "{tokens_left}",
        ),
        undo="Tick them again, and enable them.",
        button="Disable",
        done="Disabled: {names}.",
        do=USERS.each(partial(user_service.set_disabled, disabled=True)),
    ),
    ConfirmedAction(
        path="/enable",
        title="Enable {count}?",
        effects=("Each may log in again; API tokens, SSH keys and grants work as before.",),
        undo="Tick them again, and disable them.",
        button="Enable",
        done="Enabled: {names}.",
        do=USERS.each(partial(user_service.set_disabled, disabled=False)),
        is_harmless=True,
    ),
    ConfirmedAction(
        path="/group",
        title="Put {count} into group {group}?",
        effects=("Each has all grants of group {group}, for as long as it is a member.",),
        undo="Remove each from the group on its page.",
        button="Put there",
        done="Now in group {group}: {names}.",
        do=USERS.each(_add_to_group),
        hidden=(("group", "{group}"),),
        is_harmless=True,
    ),
    ConfirmedAction(
        path="/grant",
        title="Let {count} {level} {what}{end}?",
        effects=("A grant that only one of them has for {what} is replaced.",),
        undo="Remove each grant on the page of its user.",
        button="Give",
        done="May {level} {what}{end}: {names}.",
        do=_give,
        hidden=(("scope", "{scope}"), ("level", "{level}"), ("hours", "{hours}")),
        is_harmless=True,
    ),
)

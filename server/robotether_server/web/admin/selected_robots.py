"""/admin/selected-robots: what an admin does with all robots that are ticked in the list, after one question.

Each robot is changed, and written to the audit log, as alone; if one cannot be, none is.
"""

from flask import Blueprint, request

from robotether_server.db import Transaction
from robotether_server.db.audit import Source
from robotether_server.db.grants import LEVELS
from robotether_server.schemas import MAX_NAME_LENGTH
from robotether_server.services import grants as grant_service
from robotether_server.services import robots
from robotether_server.services.grants import Scope
from robotether_server.web import forms
from robotether_server.web.admin import grants
from robotether_server.web.admin.robots import ROBOTS, find
from robotether_server.web.confirmation import ConfirmedAction, Words

blueprint = Blueprint("selected_robots", __name__, url_prefix="/selected-robots")


def _words(tx: Transaction, names: list[str]) -> Words:
    for name in names:
        find(tx, name)
    site, holder = request.values.get("site", ""), request.values.get("holder", "")
    return {
        "site": site,
        "where": f"at site {site}" if site else "at no site",
        "holder": holder,
        "who": holder.replace("user:", "").replace(":", " "),
    }


def _place(tx: Transaction, source: Source, name: str) -> None:
    site = forms.optional_text("site", "Site", MAX_NAME_LENGTH)
    grant_service.place_robot(tx, source, name, site)


def _give(tx: Transaction, source: Source) -> None:
    grantee, level = grants.grantee(), forms.choice("level", "May", LEVELS)
    ends_at = grants.usual_end(tx)
    for name in ROBOTS.names(tx):
        grant_service.give(tx, source, grantee, Scope("robot", name), level, ends_at=ends_at)


ROBOTS.register(
    blueprint,
    _words,
    ConfirmedAction(
        path="/disable",
        title="Disable {count}?",
        effects=(
            "Each is cut off within 2 seconds: drivers and viewers are disconnected, and it stops by itself.",
            "Each is rejected until it is enabled again. Names, ports, grants and approved keys stay.",
            "A key that nobody has approved yet is forgotten.",
        ),
        undo="Enable each robot on its page. It reconnects by itself.",
        button="Disable",
        done="Disabled: {names}.",
        do=ROBOTS.each(robots.disable),
    ),
    ConfirmedAction(
        path="/site",
        title="Put {count} {where}?",
        effects=(
            "Users lose what only the grants for a robot's present site allow. Connections that need them are cut "
            "within 2 seconds; a robot that is driven by one stops by itself.",
        ),
        undo="Put each robot back at its site on its page.",
        button="Put there",
        done="Now {where}: {names}.",
        do=ROBOTS.each(_place),
        hidden=(("site", "{site}"),),
    ),
    ConfirmedAction(
        path="/grant",
        title="Let {who} {level} {count}{end}?",
        effects=("A grant that {who} has for only one of these robots is replaced.",),
        undo="Remove each grant on the page of {who}.",
        button="Give",
        done="{who} may {level}{end}: {names}.",
        do=_give,
        hidden=(("holder", "{holder}"), ("level", "{level}"), ("hours", "{hours}")),
        is_harmless=True,
    ),
)

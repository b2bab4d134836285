"""/drives: who drove which robot, and how; everybody's own, managers' of their robots, admins' all; also as a file."""

from collections.abc import Callable
from functools import partial

from flask import Blueprint

from robotether_server.api.drives import download
from robotether_server.db import Transaction, drives, seen_robots, users
from robotether_server.db.drives import Drive, DriveSearch
from robotether_server.web import current_user, filters
from robotether_server.web.filters import FilterChoices, Query

blueprint = Blueprint("drives", __name__, url_prefix="/drives")
blueprint.before_request(current_user.require_user)


def _finder(query: Query) -> Callable[..., list[Drive]]:
    search = DriveSearch(
        robot=query["robot"] or None,
        user=query["user"] or None,
        since=filters.since(query),
        until=filters.until(query),
    )
    return partial(drives.find, search=search)


def _offer(tx: Transaction) -> FilterChoices:
    """Name the robots that the user sees; all users to an admin, to others themselves."""
    viewer = current_user.get()
    people = users.list_all(tx) if viewer.is_admin else [viewer]
    return {
        "robot": filters.name_choices(
            seen.robot.name for seen in seen_robots.list_seen(tx, viewer)
        ),
        "user": filters.name_choices(person.name for person in people),
    }


filters.register(
    blueprint, "drives.html", ("robot", "user", "since", "until"), _finder, download, offer=_offer
)

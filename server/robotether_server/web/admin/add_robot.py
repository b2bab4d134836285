"""/admin/add-robot: a robot in three steps: which one, the line to run on it, and its arrival.

A form of the page makes the line (/admin/join-tokens), another announces a robot by its MAC, and pending.py approves
who comes without a token. The answer that holds a line is the only one that ever does.
"""

import datetime as dt
from dataclasses import dataclass

from flask import Blueprint, render_template, request

from robotether_server.api.context import context
from robotether_server.db import Transaction, cells, join_tokens, robots, seen_robots
from robotether_server.db.audit import Source
from robotether_server.db.grants import GROUPS, SITES
from robotether_server.db.join_tokens import JoinToken, Place
from robotether_server.db.seen_robots import SeenRobot
from robotether_server.install_line import EnrolmentLines, enrolment_lines
from robotether_server.problems import RobotetherError
from robotether_server.schemas import MAX_NAME_LENGTH
from robotether_server.services import robots as robot_service
from robotether_server.services import tokens
from robotether_server.web import confirmation, forms
from robotether_server.web.confirmation import ConfirmedAction, Words
from robotether_server.web.forms import Saved, form

blueprint = Blueprint("add_robot", __name__)

PAGE = "/admin/add-robot"
MAX_MAC_LENGTH = 17


@dataclass(frozen=True)
class Invitation:
    """A join token, where its robots belong, and what only the answer that makes it has: name, text and lines."""

    token: JoinToken
    place: Place
    name: str | None = None
    text: str = ""
    lines: EnrolmentLines | None = None


def show(problem: RobotetherError | None = None) -> str:
    """Show the page with nothing made yet, perhaps with the problem of one of its forms."""
    with context().database.transaction() as tx:
        return _page(tx, problem=problem)


@blueprint.get("/add-robot/<int:token_id>")
def show_arrivals(token_id: int) -> str:
    """Show who came with a token; its line was shown before."""
    with context().database.transaction() as tx:
        token = join_tokens.get(tx, token_id)
        return _page(tx, Invitation(token, join_tokens.place_of(tx, token_id)))


@form(blueprint, "/join-tokens", show)
def create_line(tx: Transaction, source: Source) -> Saved:
    """Create a join token; the answer shows its lines once."""
    uses = forms.number("uses", "Robots", 1, tokens.MAX_USES)
    hours = forms.number("hours", "Hours", 1, tokens.MAX_HOURS)
    name = forms.optional_text("name", "Name", MAX_NAME_LENGTH)
    place = Place(
        forms.optional_text("site", "Site", MAX_NAME_LENGTH),
        forms.optional_text("group", "Group", MAX_NAME_LENGTH),
        forms.optional_text("region", "Region", MAX_NAME_LENGTH),
    )
    expires_at = tx.now() + dt.timedelta(hours=hours)
    label, text = tokens.invite(tx, source, name, uses, expires_at, place=place)
    # This may raise: without a certificate to pin there is no install line, and so no token.
    lines = enrolment_lines(context().site_certificates, request.host, text, name)
    # A name is unique among join tokens.
    [token] = [token for token in join_tokens.list_all(tx) if token.name == label]
    return _page(tx, Invitation(token, place, name, text, lines))


@form(blueprint, "/add-robot", show)
def announce(tx: Transaction, source: Source) -> Saved:
    """Announce a robot by its MAC and name."""
    mac = forms.text("mac", "MAC address", MAX_MAC_LENGTH)
    name = forms.robot_name("name", "Name of the robot")
    robot = robot_service.add(tx, source, mac, name, allow_local_mac=forms.is_ticked("local_mac"))
    return (
        f"/admin/robots/{robot.name}",
        f"Robot {robot.name} is announced. It waits for the machine with MAC {robot.mac}.",
    )


def _page(
    tx: Transaction, invitation: Invitation | None = None, problem: RobotetherError | None = None
) -> str:
    everyone = seen_robots.list_all(tx)
    return render_template(
        "admin/add_robot.html",
        made=invitation,
        arrived=_arrivals(tx, everyone, invitation),
        live=f"{PAGE}/{invitation.token.id}" if invitation else request.full_path.rstrip("?"),
        sites=_choices("no site", SITES.names(tx)),
        groups=_choices("no group", GROUPS.names(tx)),
        regions=_choices("no region", cells.list_regions(tx)),
        waiting=robots.list_waiting(tx),
        rejected=robots.list_rejected_keys(tx),
        refused=robots.list_refusals(tx),
        online={seen.robot.name for seen in everyone if seen.online},
        tokens=_usable(tx),
        policy=context().join.policy,
        problem=problem,
        values=request.form,
    )


def _choices(default: str, names: list[str]) -> list[tuple[str, str]]:
    """Return the values and words of a choice; empty when there is nothing to choose."""
    return [("", default), *((name, name) for name in names)] if names else []


def _arrivals(
    tx: Transaction, everyone: list[SeenRobot], invitation: Invitation | None
) -> list[SeenRobot]:
    """Return the robots that a token admitted; without one, the robot that an admin has just approved."""
    keys = join_tokens.admitted(tx, invitation.token.id) if invitation else set()
    approved = None if invitation else request.args.get("robot")
    return [
        seen for seen in everyone if seen.robot.fingerprint in keys or seen.robot.name == approved
    ]


def _usable(tx: Transaction) -> list[JoinToken]:
    now = tx.now()
    return [
        token
        for token in join_tokens.list_all(tx)
        if token.used < token.uses and token.expires_at > now
    ]


def _token_words(token_id: int) -> Words:
    with context().database.transaction() as tx:
        token = join_tokens.get(tx, token_id)
    return {"token": token, "uses_left": token.uses - token.used}


confirmation.register(
    blueprint,
    PAGE,
    _token_words,
    ConfirmedAction(
        path="/join-tokens/<int:token_id>/delete",
        title="Revoke join token {token.name}?",
        effects=(
            "No robot can join with it from now on; {uses_left} of {token.uses} uses are left.",
            "Robots that joined with it stay.",
        ),
        undo="A revoked token cannot be restored; add the robot again.",
        button="Revoke",
        done="Join token {token.name} is revoked.",
        do=tokens.delete_join_token,
    ),
)

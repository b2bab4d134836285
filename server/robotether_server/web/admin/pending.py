"""/admin/pending: keys that wait for an admin, and rejected keys.

A join proves nothing but that somebody knows a MAC, so the page shows the fingerprint to compare, and approves that
key and no other.
"""

from flask import Blueprint, render_template, request
from werkzeug.wrappers import Response as AnyResponse

from robotether_server.api.context import context
from robotether_server.db import seen_robots
from robotether_server.problems import Problem, RecordMissing
from robotether_server.schemas import MAX_NAME_LENGTH
from robotether_server.services import pending, robots
from robotether_server.services.pending import PendingKey, RejectedKey
from robotether_server.web import confirmation, current_user, forms
from robotether_server.web.confirmation import METHODS, ConfirmedAction

blueprint = Blueprint("pending", __name__, url_prefix="/pending")

MAX_FINGERPRINT_LENGTH = 100
PAGE = "/admin/pending"


@blueprint.get("")
def show() -> str:
    """Show who waits and who was rejected."""
    return _page()


@blueprint.post("")
def approve() -> AnyResponse | tuple[str, int]:
    """Approve one key that waits, perhaps under another name."""
    try:
        name = forms.text("robot", "Robot", MAX_NAME_LENGTH)
        fingerprint = forms.text("fingerprint", "Fingerprint", MAX_FINGERPRINT_LENGTH)
        new_name = forms.text("name", "Name", MAX_NAME_LENGTH)
        with context().database.transaction() as tx:
            robots.approve(tx, current_user.source(), name, fingerprint)
            if new_name != name:
                robots.rename(tx, current_user.source(), name, new_name)
    except Problem as problem:
        return _page(problem), problem.status
    return confirmation.go_on(
        PAGE, f"Robot {new_name} is approved. It connects by itself within a minute."
    )


@blueprint.route("/replace/<name>", methods=METHODS)
def replace(name: str) -> AnyResponse:
    """Approve a key in place of the one that the robot of that MAC has."""
    waiting = _waiting(name)
    action = ConfirmedAction(
        title=f"Give robot {name} the new key?",
        effects=(
            f"The machine that has the key of {name} now is disconnected within 2 seconds, and its key is forgotten.",
            f"The machine {waiting.hostname} at {waiting.address} becomes {name}: name, ports and grants are its own.",
            f"The new key is {waiting.fingerprint}. Compare it on that machine with: robotether-agent status",
        ),
        undo="The old key cannot be restored; the old machine would have to join and wait for approval.",
        button="Replace the key",
        done=f"Robot {name} has the new key.",
        back=PAGE,
        hidden=(("fingerprint", waiting.fingerprint),),
    )
    return confirmation.run(
        action, lambda tx, source: robots.approve(tx, source, name, waiting.fingerprint)
    )


@blueprint.route("/reject/<name>", methods=METHODS)
def reject(name: str) -> AnyResponse:
    """Turn a key away."""
    waiting = _waiting(name)
    action = ConfirmedAction(
        title=f"Reject the key that waits for robot {name}?",
        effects=(
            f"The machine {waiting.hostname} at {waiting.address} (MAC {waiting.mac}) is rejected with this key: "
            f"{waiting.fingerprint}",
            _what_stays(waiting),
        ),
        undo="Allow the key to ask again, in the list of rejected keys.",
        button="Reject",
        done=f"The key that waited for robot {name} is rejected.",
        back=PAGE,
        hidden=(("fingerprint", waiting.fingerprint),),
    )
    return confirmation.run(
        action, lambda tx, source: robots.reject(tx, source, name, waiting.fingerprint)
    )


@blueprint.route("/rejected/<int:key_id>", methods=METHODS)
def forgive(key_id: int) -> AnyResponse:
    """Forget a rejection: the key may join again."""
    key = _rejected(key_id)
    action = ConfirmedAction(
        title="Allow this key to ask again?",
        effects=(
            f"The machine {key.hostname} (MAC {key.mac}) with key {key.fingerprint} waits for approval when it asks "
            "the next time.",
        ),
        undo="Reject it again when it waits.",
        button="Allow it to ask again",
        done="The key may ask again.",
        back=PAGE,
        is_harmless=True,
    )
    return confirmation.run(action, lambda tx, source: pending.forgive(tx, source, key_id))


def _page(problem: Problem | None = None) -> str:
    with context().database.transaction() as tx:
        seen = seen_robots.list_seen(tx, current_user.get())
        return render_template(
            "admin/pending.html",
            online={one.robot.name for one in seen if one.online},
            waiting=pending.waiting(tx),
            rejected=pending.rejected(tx),
            policy=context().join.policy,
            problem=problem,
            values=request.form,
        )


def _waiting(name: str) -> PendingKey:
    """Return the waiting key that the page showed; another one may have come since."""
    fingerprint = request.values.get("fingerprint", "")
    with context().database.transaction() as tx:
        for one in pending.waiting(tx):
            if (one.robot, one.fingerprint) == (name, fingerprint):
                return one
    raise RecordMissing(
        f"cannot find that key of robot {name}: it no longer waits; see {PAGE} for the keys that do"
    )


def _rejected(key_id: int) -> RejectedKey:
    with context().database.transaction() as tx:
        for one in pending.rejected(tx):
            if one.id == key_id:
                return one
    raise RecordMissing("cannot find that rejected key: it may already ask again")


def _what_stays(waiting: PendingKey) -> str:
    if waiting.reason == "mac_in_use":
        return f"Robot {waiting.robot} keeps the key that it has."
    return "A robot that nobody announced is removed from the list; an announced one waits for another key."

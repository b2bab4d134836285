"""What an admin does about keys that wait, and rejected ones; /admin/add-robot shows them.

A join only proves that somebody knows a MAC, so the page shows the fingerprint to compare, and approves that
key and no other.
"""

from urllib.parse import urlencode

from flask import Blueprint, request

from robotether_server.api.context import context
from robotether_server.db import Transaction
from robotether_server.db import robots as db_robots
from robotether_server.db.audit import Source
from robotether_server.problems import RecordMissingError
from robotether_server.schemas import MAX_NAME_LENGTH
from robotether_server.services import pending, robots
from robotether_server.web import confirmation, forms
from robotether_server.web.admin import add_robot
from robotether_server.web.confirmation import ConfirmedAction, Words
from robotether_server.web.forms import Saved, form

blueprint = Blueprint("pending", __name__, url_prefix="/pending")

MAX_FINGERPRINT_LENGTH = 100
PAGE = f"{add_robot.PAGE}#waiting"


@form(blueprint, "", add_robot.show)
def approve(tx: Transaction, source: Source) -> Saved:
    """Approve one key that waits, perhaps under another name."""
    name = forms.text("robot", "Robot", MAX_NAME_LENGTH)
    fingerprint = forms.text("fingerprint", "Fingerprint", MAX_FINGERPRINT_LENGTH)
    new_name = forms.robot_name("name", "Name")
    robots.approve(tx, source, name, fingerprint)
    robots.rename(tx, source, name, new_name)
    onward = f"{add_robot.PAGE}?{urlencode({'robot': new_name})}#waiting"
    return onward, f"Robot {new_name} is approved. It connects by itself within a minute."


def _fingerprint() -> str:
    """Return the fingerprint that the page showed; another key may wait since."""
    return request.values.get("fingerprint", "")


def _replace(tx: Transaction, source: Source, name: str) -> None:
    robots.approve(tx, source, name, _fingerprint())


def _reject(tx: Transaction, source: Source, name: str) -> None:
    robots.reject(tx, source, name, _fingerprint())


def _waiting_words(name: str) -> Words:
    with context().database.transaction() as tx:
        for key in db_robots.list_waiting(tx):
            if (key.robot, key.fingerprint) == (name, _fingerprint()):
                stays = (
                    f"Robot {name} keeps the key that it has."
                    if key.reason == "mac_in_use"
                    else "A robot that nobody announced is removed from the list; "
                    "an announced one waits for another key."
                )
                return {"key": key, "stays": stays}
    raise RecordMissingError(
        f"cannot find that key of robot {name}: it no longer waits; see {add_robot.PAGE} for the keys that do"
    )


def _rejected_words(rejected_id: int) -> Words:
    with context().database.transaction() as tx:
        return {"key": db_robots.get_rejected_key(tx, rejected_id)}


confirmation.register(
    blueprint,
    PAGE,
    _waiting_words,
    ConfirmedAction(
        path="/replace/<name>",
        title="Give robot {key.robot} the new key?",
        effects=(
            "The machine that has the key of {key.robot} now is disconnected within 2 seconds, and its key is "
            "forgotten.",
            "The machine {key.hostname} at {key.address} becomes {key.robot}: name, ports and grants are its own.",
            "The new key is {key.fingerprint}. Compare it on that machine with: robotether-agent status",
        ),
        undo="The old key cannot be restored; the old machine would have to join and wait for approval.",
        button="Replace the key",
        done="Robot {key.robot} has the new key.",
        do=_replace,
        hidden=(("fingerprint", "{key.fingerprint}"),),
    ),
    ConfirmedAction(
        path="/reject/<name>",
        title="Reject the key that waits for robot {key.robot}?",
        effects=(
            "The machine {key.hostname} at {key.address} (MAC {key.mac}) is rejected with this key: "
            "{key.fingerprint}",
            "{stays}",
        ),
        undo="Allow the key to ask again, in the list of rejected keys.",
        button="Reject",
        done="The key that waited for robot {key.robot} is rejected.",
        do=_reject,
        hidden=(("fingerprint", "{key.fingerprint}"),),
    ),
)
confirmation.register(
    blueprint,
    PAGE,
    _rejected_words,
    ConfirmedAction(
        path="/rejected/<int:rejected_id>",
        title="Allow this key to ask again?",
        effects=(
            "The machine {key.hostname} (MAC {key.mac}) with key {key.fingerprint} waits for approval when it asks "
            "the next time.",
        ),
        undo="Reject it again when it waits.",
        button="Allow it to ask again",
        done="The key may ask again.",
        do=pending.forgive,
        is_harmless=True,
    ),
)

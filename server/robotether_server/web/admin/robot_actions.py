"""What an admin does with one robot by a yes: disable, enable, forget or change its key, its shell, remove it."""

from flask import Blueprint
from werkzeug.wrappers import Response as AnyResponse

from robotether_server.services import robots
from robotether_server.web import confirmation
from robotether_server.web.admin.robot_page import get, page_of
from robotether_server.web.confirmation import METHODS, ConfirmedAction

blueprint = Blueprint("robot_actions", __name__, url_prefix="/robots/<name>")


@blueprint.route("/disable", methods=METHODS)
def disable(name: str) -> AnyResponse:
    """Keep a robot out."""
    get(name)
    action = ConfirmedAction(
        title=f"Disable robot {name}?",
        effects=(
            f"{name} is cut off within 2 seconds: who drives or watches it is thrown out, it stops by itself.",
            "It is refused until it is enabled again. Name, ports, grants and an approved key stay.",
            "A key that nobody has approved yet is forgotten.",
        ),
        undo="Enable the robot on its page. It comes back by itself.",
        button="Disable",
        done=f"Robot {name} is disabled.",
        back=page_of(name),
    )
    return confirmation.run(action, lambda tx, source: robots.disable(tx, source, name))


@blueprint.route("/enable", methods=METHODS)
def enable(name: str) -> AnyResponse:
    """Let a disabled robot in again."""
    get(name)
    action = ConfirmedAction(
        title=f"Enable robot {name}?",
        effects=(
            "With its key it connects again by itself, within a minute.",
            "Without a key it waits for the machine to join and for an admin to approve it.",
        ),
        undo="Disable the robot again.",
        button="Enable",
        done=f"Robot {name} is enabled.",
        back=page_of(name),
        is_harmless=True,
    )
    return confirmation.run(action, lambda tx, source: robots.enable(tx, source, name))


@blueprint.route("/rekey", methods=METHODS)
def rekey(name: str) -> AnyResponse:
    """Forget the key of a robot."""
    get(name)
    action = ConfirmedAction(
        title=f"Forget the key of robot {name}?",
        effects=(
            f"{name} is cut off within 2 seconds. Name, ports and grants stay.",
            "The next key that the machine shows waits for an admin to approve it.",
            "Use this when the machine has a new disk, or when its key may be in other hands.",
        ),
        undo="A forgotten key cannot be brought back. The robot joins again by itself, and you approve its key.",
        button="Forget the key",
        done=f"Robot {name} has no key any more. Approve the next one when it waits.",
        back=page_of(name),
    )
    return confirmation.run(action, lambda tx, source: robots.rekey(tx, source, name))


@blueprint.route("/rotate-key", methods=METHODS)
def rotate_key(name: str) -> AnyResponse:
    """Ask the agent for a new key."""
    get(name)
    action = ConfirmedAction(
        title=f"Ask robot {name} for a new key?",
        effects=(
            "Its agent makes a new key and proves with the old one that it is the same robot. Nothing is cut.",
            "A robot that is offline does so when it is back.",
        ),
        undo="A robot that has changed its key does not go back to the old one; ask for another one at any time.",
        button="Ask for a new key",
        done=f"Robot {name} is asked for a new key.",
        back=page_of(name),
        is_harmless=True,
    )
    return confirmation.run(action, lambda tx, source: robots.rotate_key(tx, source, name))


@blueprint.route("/shell-on", methods=METHODS)
def shell_on(name: str) -> AnyResponse:
    """Open the way to a robot's own sshd."""
    get(name)
    action = ConfirmedAction(
        title=f"Turn the shell of robot {name} on?",
        effects=(
            "Admins, and users with a grant to manage it, reach the SSH port of this robot through the server.",
            "They need an SSH key in their profile here, and an account on the robot that takes their key.",
        ),
        undo="Turn the shell off again.",
        button="Turn on",
        done=f"The shell of robot {name} is on.",
        back=page_of(name),
        is_harmless=True,
    )
    return confirmation.run(action, lambda tx, source: robots.set_shell(tx, source, name, True))


@blueprint.route("/shell-off", methods=METHODS)
def shell_off(name: str) -> AnyResponse:
    """Close the way to a robot's own sshd."""
    get(name)
    action = ConfirmedAction(
        title=f"Turn the shell of robot {name} off?",
        effects=(
            f"SSH connections to {name} are cut within 2 seconds, copies and playbooks at work included.",
            "The robot connects anew, so who drives or watches it is interrupted for a moment.",
            "Its shell port is free for another robot.",
        ),
        undo="Turn the shell on again. It may get another port: people fetch their SSH configuration anew.",
        button="Turn off",
        done=f"The shell of robot {name} is off.",
        back=page_of(name),
    )
    return confirmation.run(action, lambda tx, source: robots.set_shell(tx, source, name, False))


@blueprint.route("/remove", methods=METHODS)
def remove(name: str) -> AnyResponse:
    """Remove a robot's record."""
    seen = get(name)
    action = ConfirmedAction(
        title=f"Remove robot {name}?",
        effects=(
            f"The record of {name} (MAC {seen.robot.mac}) goes, with its key, ports, grants, settings and sessions.",
            "It is cut off within 2 seconds. The audit log stays.",
            "An agent that still runs on the machine asks again and waits as an unknown robot; to stop that, "
            "retire the machine first, or disable the robot instead.",
        ),
        undo="A removed robot cannot be brought back; announce it or let it join again, then give the grants anew.",
        button="Remove",
        done=f"Robot {name} is removed.",
        back=page_of(name),
        onward="/admin/robots",
    )
    return confirmation.run(action, lambda tx, source: robots.remove(tx, source, name))

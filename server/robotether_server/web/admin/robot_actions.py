"""What an admin does with one robot after a question: disable, enable, change its key or shell, remove it."""

from flask import Blueprint, request
from werkzeug.wrappers import Response as AnyResponse

from robotether_server.db import Transaction
from robotether_server.db.audit import Source
from robotether_server.robot_settings import Settings, put_path, remove_path
from robotether_server.schemas import MAX_NAME_LENGTH
from robotether_server.services import robots
from robotether_server.web import confirmation, forms
from robotether_server.web.admin.robot_pages import get, page_of
from robotether_server.web.confirmation import METHODS, ConfirmedAction, Field

blueprint = Blueprint("robot_actions", __name__, url_prefix="/robots/<name>")


MAX_MAC_LENGTH = 17
MAX_USER_LENGTH = 32


@blueprint.route("/disable", methods=METHODS)
def disable(name: str) -> AnyResponse:
    """Disable a robot."""
    get(name)
    action = ConfirmedAction(
        title=f"Disable robot {name}?",
        effects=(
            f"{name} is cut off within 2 seconds: drivers and viewers are disconnected, and it stops by itself.",
            "It is rejected until it is enabled again. Name, ports, grants and an approved key stay.",
            "A key that nobody has approved yet is forgotten.",
        ),
        undo="Enable the robot on its page. It reconnects by itself.",
        button="Disable",
        done=f"Robot {name} is disabled.",
        back=page_of(name),
    )
    return confirmation.run(action, lambda tx, source: robots.disable(tx, source, name))


@blueprint.route("/enable", methods=METHODS)
def enable(name: str) -> AnyResponse:
    """Enable a disabled robot."""
    get(name)
    action = ConfirmedAction(
        title=f"Enable robot {name}?",
        effects=(
            "With its key it reconnects by itself, within a minute.",
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
            "Use this when the machine has a new disk, or when somebody else may have its key.",
        ),
        undo="A forgotten key cannot be restored. The robot joins again by itself, and you approve its key.",
        button="Forget the key",
        done=f"Robot {name} has no key now. Approve the next one when it waits.",
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
            "Its agent makes a new key and proves with the old one that it is the same robot. Nothing is disconnected.",
            "An offline robot does so when it is back.",
        ),
        undo="A robot that has changed its key does not return to the old one; ask for another one at any time.",
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
            "They need an SSH key in their profile here, and an account on the robot that accepts it.",
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
            f"SSH connections to {name} are cut within 2 seconds, including copies and playbooks that are running.",
            "The robot reconnects, so drivers and viewers are interrupted for a moment.",
            "Its shell port is free for another robot.",
        ),
        undo="Turn the shell on again. It may get another port: people then download their SSH configuration again.",
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
            f"The record of {name} (MAC {seen.robot.mac}) is deleted, with its key, ports, grants, settings "
            "and sessions.",
            "It is disconnected within 2 seconds. The audit log stays.",
            "An agent that still runs on the machine asks again and waits as an unknown robot; to stop that, "
            "retire the machine first, or disable the robot instead.",
        ),
        undo="A removed robot cannot be restored; announce it or let it join again, then give the grants again.",
        button="Remove",
        done=f"Robot {name} is removed.",
        back=page_of(name),
        onward="/admin/robots",
    )
    return confirmation.run(action, lambda tx, source: robots.remove(tx, source, name))


LOWEST_PORT, HIGHEST_PORT = 1024, 65535


@blueprint.route("/rename", methods=METHODS)
def rename(name: str) -> AnyResponse:
    """Give a robot another name."""
    get(name)
    new = request.form.get("new_name", "").strip()
    action = ConfirmedAction(
        title=f"Rename robot {name}",
        effects=(
            "Its tunnel stays; drivers have to open it by its new name.",
            "Links, programs and SSH configurations with the old name no longer find it.",
            "Key, ports and grants stay.",
        ),
        undo=f"Rename it back to {name}, unless another robot has taken that name.",
        button="Rename",
        done=f"Robot {name} is now {new}.",
        back=page_of(name),
        onward=page_of(new),
        fields=(Field("new_name", "New name", name, "a-z, 0-9 and -, neither first nor last a -"),),
        is_harmless=True,
    )

    def do(tx: Transaction, source: Source) -> None:
        robots.rename(tx, source, name, forms.text("new_name", "New name", MAX_NAME_LENGTH))

    return confirmation.run(action, do)


@blueprint.route("/mac", methods=METHODS)
def set_mac(name: str) -> AnyResponse:
    """Give a robot another MAC."""
    robot = get(name).robot
    action = ConfirmedAction(
        title=f"Change the MAC of robot {name}",
        effects=(
            "For a robot that got a new network card. Name, key, ports, grants and tunnel stay.",
            f"A machine that shows the current MAC {robot.mac} becomes an unknown robot.",
        ),
        undo=f"Change it back to {robot.mac}.",
        button="Change the MAC",
        done=f"Robot {name} has another MAC.",
        back=page_of(name),
        fields=(
            Field("mac", "MAC address", robot.mac, "in any usual spelling: 00:1b:44:11:3a:b7"),
            Field(
                "local_mac",
                "It may be locally administered",
                hint="Made up by software; two machines may have the same.",
                kind="box",
            ),
        ),
    )

    def do(tx: Transaction, source: Source) -> None:
        mac = forms.text("mac", "MAC address", MAX_MAC_LENGTH)
        robots.set_mac(tx, source, name, mac, allow_local_mac=forms.is_ticked("local_mac"))

    return confirmation.run(action, do)


@blueprint.route("/ports", methods=METHODS)
def move_ports(name: str) -> AnyResponse:
    """Give a robot another pair of ports."""
    robot = get(name).robot
    hint = "Leave both empty for a free pair."
    action = ConfirmedAction(
        title=f"Move the ports of robot {name}",
        effects=(
            f"Now: {robot.ros_port} (rosbridge) and {robot.video_port} (video).",
            f"{name} reconnects within seconds: drivers and viewers are interrupted, and it stops by itself.",
            "Pages of this site find it again by themselves; programs that use the ports directly do not.",
        ),
        undo=f"Move them back to {robot.ros_port} and {robot.video_port}, unless another robot has taken them.",
        button="Move",
        done=f"The ports of robot {name} are moved.",
        back=page_of(name),
        fields=(
            Field("ros_port", "rosbridge port", hint=hint, kind="number"),
            Field("video_port", "Video port", kind="number"),
        ),
    )

    def do(tx: Transaction, source: Source) -> None:
        ros_port = _port("ros_port", "rosbridge port")
        robots.move_ports(tx, source, name, ros_port, _port("video_port", "Video port"))

    return confirmation.run(action, do)


@blueprint.route("/shell-user", methods=METHODS)
def set_shell_user(name: str) -> AnyResponse:
    """Set the account on the robot that a shell logs in to."""
    settings = get(name).robot.settings
    action = ConfirmedAction(
        title=f"Shell user of robot {name}",
        effects=(
            "The account on the robot that the SSH configuration names, such as pi or ubuntu.",
            "Empty: everybody's own user name. People download their SSH configuration again to get the change.",
        ),
        undo="Set it back at any time.",
        button="Save",
        done=f"The shell user of robot {name} is saved.",
        back=page_of(name),
        fields=(Field("shell_user", "Shell user", str(settings.get("shell_user", ""))),),
        is_harmless=True,
    )

    def do(tx: Transaction, source: Source) -> None:
        user = forms.optional_text("shell_user", "Shell user", MAX_USER_LENGTH)

        def change(present: Settings) -> Settings:
            if user is None:
                return remove_path(present, "shell_user")
            return put_path(present, "shell_user", user)

        robots.change_settings(tx, source, name, change)

    return confirmation.run(action, do)


def _port(name: str, label: str) -> int | None:
    return forms.optional_number(name, label, LOWEST_PORT, HIGHEST_PORT)

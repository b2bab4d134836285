"""What an admin changes of one robot by a form: its name, MAC, ports and the user of its shell."""

from flask import Blueprint, request
from werkzeug.wrappers import Response as AnyResponse

from robotether_server.db import Transaction
from robotether_server.db.audit import Source
from robotether_server.services import robots
from robotether_server.services.names import MAX_NAME_LENGTH
from robotether_server.setting_paths import Settings, put_path, remove_path
from robotether_server.web import confirmation, forms
from robotether_server.web.admin.robot_page import get, page_of
from robotether_server.web.confirmation import METHODS, ConfirmedAction, Field

blueprint = Blueprint("robot_changes", __name__, url_prefix="/robots/<name>")

MAX_MAC_LENGTH = 17
MAX_USER_LENGTH = 32
LOWEST_PORT, HIGHEST_PORT = 1024, 65535


@blueprint.route("/rename", methods=METHODS)
def rename(name: str) -> AnyResponse:
    """Give a robot another name."""
    get(name)
    new = request.form.get("new_name", "").strip()
    action = ConfirmedAction(
        title=f"Rename robot {name}",
        effects=(
            "Its tunnel stays; who drives it has to open it by its new name.",
            "Links, programs and SSH configurations that have the old name do not find it any more.",
            "Key, ports and grants stay.",
        ),
        undo=f"Rename it back to {name}, as long as no other robot takes that name.",
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
            f"A machine that shows the present MAC {robot.mac} becomes an unknown robot.",
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
                hint="Made up by software; such an address may turn up twice.",
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
            f"{name} connects anew within seconds: who drives or watches it is interrupted, it stops by itself.",
            "Pages of this site find it again by themselves; programs that use the ports directly do not.",
        ),
        undo=f"Move them back to {robot.ros_port} and {robot.video_port}, as long as no other robot takes them.",
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
    """Say which account on the robot a shell logs in to."""
    settings = get(name).robot.settings
    action = ConfirmedAction(
        title=f"Shell user of robot {name}",
        effects=(
            "The account on the robot that the SSH configuration names, such as pi or ubuntu.",
            "Empty: everybody's own user name. People fetch their SSH configuration anew to get the change.",
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

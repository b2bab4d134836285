"""robotether robot ...: the list of commands about robots; those that add, show, change, watch and remove one.

`robotether stop` is for programmers on a machine of their own: it asks the API, and no database.
A change reaches a live tunnel within 2 s: it is cut, or gets its new settings.
"""

import os
from dataclasses import asdict
from http import HTTPStatus
from http.client import HTTPException, HTTPSConnection
from ssl import SSLCertVerificationError
from urllib.parse import quote

import click
import msgspec

from robotether_server.cli import robot_texts
from robotether_server.cli.common import (
    JSON,
    SOURCE,
    YES,
    NotDoneError,
    add_list,
    harmless,
    open_database,
    print_fields,
    print_json,
    print_table,
    remove_after_question,
    wait_for,
)
from robotether_server.cli.robot_keys import (
    approve,
    reject,
    rekey,
    rotate_key,
)
from robotether_server.cli.robot_settings import set_settings, show_settings
from robotether_server.cli.tokens import invite
from robotether_server.contract.control import ControlObject, StopReason
from robotether_server.db import Database, seen_robots
from robotether_server.db import robots as db_robots
from robotether_server.install_line import SiteAddress, parse_site_address
from robotether_server.problems import reason_in
from robotether_server.services import robots

PORT = click.IntRange(1024, 65535)


SESSIONS_SHOWN = 5
# Time limit for the server's answer to a stop, for which it waits for the guard.
STOP_WITHIN_S = 10.0


@click.command()
@click.argument("name")
@click.option("--host", required=True, metavar="HOST[:PORT]", help="Where the site is.")
@click.option("--reason", help="What people read beside the stop.")
def stop(name: str, host: str, reason: str | None) -> None:
    """Stop a robot until somebody releases it.

    Over the API, with the token in ROBOTETHER_TOKEN. Fails unless the robot's guard confirms the stop. This is no
    safety-rated emergency stop.
    """
    # As a file has it, with the end of its line.
    token = os.environ.get("ROBOTETHER_TOKEN", "").strip()
    if not token:
        raise NotDoneError(f"cannot stop robot {name}: put an API token in ROBOTETHER_TOKEN")
    stopped = _post_stop(parse_site_address(host), token, name, reason).stopped
    if stopped is None:
        raise NotDoneError(f"robot {name} is not stopped: somebody has released it already")
    if not stopped.confirmed:
        raise NotDoneError(
            f"the server has stopped robot {name}, but the robot has not confirmed it and may still move"
        )
    click.echo(f"robot {name} is stopped, and its guard has confirmed it")


def _post_stop(site: SiteAddress, token: str, name: str, reason: str | None) -> ControlObject:
    headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}
    connection = HTTPSConnection(site.host, site.port, timeout=STOP_WITHIN_S)
    try:
        path = f"/api/v1/robots/{quote(name, safe='')}/stop"
        connection.request("POST", path, msgspec.json.encode(StopReason(reason)), headers)
        response = connection.getresponse()
        answer = response.read()
        if response.status == HTTPStatus.OK:
            return msgspec.json.decode(answer, type=ControlObject)
        why = str(msgspec.json.decode(answer, type=dict)["detail"])
    except (OSError, HTTPException, KeyError, ValueError, msgspec.MsgspecError) as error:
        # ValueError: the token, or another word, is no text that HTTP takes.
        why = reason_in(error)
        if isinstance(error, SSLCertVerificationError):
            why += "; SSL_CERT_FILE can name the file of a certificate that you trust"
    finally:
        connection.close()
    raise NotDoneError(f"nothing confirms that robot {name} is stopped: {harmless(why)}")


@click.command()
@click.argument("name")
def disable(name: str) -> None:
    """Disable a robot, and end its connection.

    No key connects it until: enable.
    """
    with open_database().transaction() as tx:
        robots.disable(tx, SOURCE, name)
    click.echo(f"robot {name} is disabled")


@click.command()
@click.argument("name")
def enable(name: str) -> None:
    """Enable a disabled robot."""
    with open_database().transaction() as tx:
        enabled = robots.enable(tx, SOURCE, name)
    click.echo(f"robot {name} is {enabled.state}")


@click.command()
@click.argument("name")
@click.argument("new_name")
def rename(name: str, new_name: str) -> None:
    """Give a robot another name.

    Grants, ports and its connection stay; its URLs change.
    """
    with open_database().transaction() as tx:
        robots.rename(tx, SOURCE, name, new_name)
    click.echo(f"robot {name} is now {new_name}")


@click.command("set-mac")
@click.argument("name")
@click.argument("mac")
@click.option("--allow-local-mac", is_flag=True, help="Accept a locally administered MAC.")
def set_mac(name: str, mac: str, allow_local_mac: bool) -> None:
    """Give a robot another MAC."""
    with open_database().transaction() as tx:
        changed = robots.set_mac(tx, SOURCE, name, mac, allow_local_mac=allow_local_mac)
    click.echo(f"robot {name} has MAC {changed.mac}")


@click.command("move-ports")
@click.argument("name")
@click.option("--ros", type=PORT, help="Port for rosbridge, from the server's range.")
@click.option("--video", type=PORT, help="Port for video; goes with --ros.")
def move_ports(name: str, ros: int | None, video: int | None) -> None:
    """Move a robot to other ports.

    Without any, to a pair that is free. The robot connects again.
    """
    if (ros is None) != (video is None):
        raise NotDoneError(f"cannot move robot {name}: --ros and --video go together")
    with open_database().transaction() as tx:
        moved = robots.move_ports(tx, SOURCE, name, ros, video)
    click.echo(f"robot {name} has ports {moved.ros_port} and {moved.video_port}")


@click.command()
@click.argument("name")
@click.argument("switch", type=click.Choice(("on", "off")))
def shell(name: str, switch: str) -> None:
    """Turn shells on a robot on or off.

    While it is on, people who manage the robot reach its own SSH server. They need an account there, a key in
    their profile here, and: robotether ssh-config.
    """
    with open_database().transaction() as tx:
        changed = robots.set_shell(tx, SOURCE, name, switch == "on")
    where = f", at port {changed.shell_port} of the server" if changed.shell_port else ""
    click.echo(f"the shell of robot {name} is {switch}{where}")


@click.group()
def robot() -> None:
    """Add, approve, change, watch and remove robots."""


add_list(
    robot,
    "List the robots.",
    seen_robots.list_all,
    robot_texts.HEADS,
    robot_texts.as_row,
    as_dict=robot_texts.as_dict,
)
add_list(
    robot,
    "List the keys that wait for an admin, the oldest first.",
    db_robots.list_waiting,
    robot_texts.WAITING_HEADS,
    robot_texts.as_waiting_row,
    name="pending",
)


@robot.command()
@click.argument("name")
@click.option("--mac", required=True, help="MAC address, in any usual spelling.")
@click.option(
    "--allow-local-mac",
    is_flag=True,
    help="Accept a locally administered MAC, as virtual machines and containers have.",
)
def add(name: str, mac: str, allow_local_mac: bool) -> None:
    """Add a robot before it joins.

    It gets its ports at once, and waits for its key.
    """
    with open_database().transaction() as tx:
        added = robots.add(tx, SOURCE, mac, name, allow_local_mac=allow_local_mac)
    click.echo(f"added robot {name} with ports {added.ros_port} and {added.video_port}")


@robot.command()
@click.argument("name")
@JSON
def show(name: str, as_json: bool) -> None:
    """Show all about one robot.

    Its record, the keys that wait there, and its last sessions.
    """
    with open_database().transaction() as tx:
        seen = seen_robots.get_seen(tx, name)
        waiting = [key for key in db_robots.list_waiting(tx) if key.robot == name]
        last = seen_robots.sessions_of(tx, seen.robot.id, SESSIONS_SHOWN)
    if as_json:
        more = {
            "waiting": [vars(key) for key in waiting],
            "sessions": [asdict(session) for session in last],
        }
        print_json(robot_texts.as_dict(seen) | more)
        return
    print_fields(robot_texts.everything(seen))
    if waiting:
        click.echo()
        print_table(robot_texts.WAITING_HEADS, [robot_texts.as_waiting_row(key) for key in waiting])
    if last:
        click.echo()
        print_table(
            robot_texts.SESSION_HEADS, [robot_texts.as_session_row(session) for session in last]
        )


@robot.command()
@click.argument("name")
@YES
def remove(name: str, yes: bool) -> None:
    """Remove a robot with its grants and its history.

    Its MAC and ports become free, and its connection ends. An agent that still runs joins again, and waits like any
    unknown robot. There is no undo.
    """
    remove_after_question(
        "robot",
        name,
        "Remove it, with its grants?",
        get=db_robots.get,
        remove=robots.remove,
        yes=yes,
        describe=robot_texts.identity,
    )


@robot.command("wait-online")
@click.argument("name")
@click.option("--timeout", type=float, default=60, show_default=True, metavar="SECONDS")
def wait_online(name: str, timeout: float) -> None:
    """Wait until the robot's tunnel is up."""
    database = open_database()
    if wait_for(lambda: _online(database, name), timeout) is None:
        raise NotDoneError(
            f"cannot see robot {name} online after {timeout:g} s: see its agent's log"
        )
    click.echo(f"robot {name} is online")


def _online(database: Database, name: str) -> bool | None:
    with database.transaction() as tx:
        return seen_robots.get_seen(tx, name).online or None


for command in (
    approve,
    disable,
    enable,
    invite,
    move_ports,
    reject,
    rekey,
    rename,
    rotate_key,
    set_mac,
    set_settings,
    shell,
    show_settings,
):
    robot.add_command(command)

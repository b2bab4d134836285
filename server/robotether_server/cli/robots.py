"""robotether robot ...: add, approve, disable and watch robots."""

import json

import click

from robotether_server import macs
from robotether_server.cli.common import SOURCE, NotDone, open_database, print_table, wait_for
from robotether_server.store import Database, Transaction, audit, robots
from robotether_server.store.audit import Event
from robotether_server.store.robots import Robot, SeenRobot, State


@click.group()
def robot() -> None:
    """Add, list, approve, disable and enable robots."""


@robot.command()
@click.argument("name")
@click.option("--mac", required=True, help="MAC address, in any usual spelling.")
def add(name: str, mac: str) -> None:
    """Add a robot before it joins; it gets its ports at once, and waits for its key."""
    with open_database().transaction() as tx:
        robots.add(tx, macs.normalise(mac), name)
        added = robots.get(tx, name)
        audit.record(tx, SOURCE, Event("robot_added", name, {"mac": added.mac}))
    click.echo(f"added robot {name} with ports {added.ros_port} and {added.video_port}")


@robot.command("list")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def list_robots(as_json: bool) -> None:
    """List the robots."""
    with open_database().transaction() as tx:
        found = robots.list_all(tx)
    if as_json:
        click.echo(json.dumps([_as_dict(seen) for seen in found], indent=2))
        return
    heads = ("NAME", "STATE", "ONLINE", "SINCE", "MAC", "ROS", "VIDEO", "KEY")
    print_table(heads, [_as_cells(seen) for seen in found])


@robot.command()
@click.argument("name")
@click.option(
    "--wait-for-key", type=float, default=0, metavar="SECONDS", help="Wait until it has joined."
)
def approve(name: str, wait_for_key: float) -> None:
    """Let a pending robot in: the key that it showed becomes its own."""
    database = open_database()
    wait_for(lambda: _get(database, name).fingerprint, wait_for_key)
    with database.transaction() as tx:
        found = robots.get(tx, name)
        if found.state == "disabled":
            raise NotDone(
                f"cannot approve robot {name}: it is disabled; use: robotether robot enable {name}"
            )
        if found.fingerprint is None:
            raise NotDone(
                f"cannot approve robot {name}: it has not joined yet, so there is no key to approve"
            )
        _change_state(tx, found, "active", "robot_approved")
    click.echo(f"robot {name} is active with key {found.fingerprint}")


@robot.command()
@click.argument("name")
def disable(name: str) -> None:
    """Keep a robot out, whatever its key."""
    with open_database().transaction() as tx:
        _change_state(tx, robots.get(tx, name), "disabled", "robot_disabled")
    click.echo(f"robot {name} is disabled")


@robot.command()
@click.argument("name")
def enable(name: str) -> None:
    """Let a disabled robot in again."""
    with open_database().transaction() as tx:
        found = robots.get(tx, name)
        if found.state != "disabled":
            raise NotDone(f"cannot enable robot {name}: it is {found.state}, not disabled")
        # Without a key there is nothing yet that could prove to be this robot.
        state: State = "active" if found.fingerprint else "pending"
        _change_state(tx, found, state, "robot_enabled")
    click.echo(f"robot {name} is {state}")


@robot.command("wait-online")
@click.argument("name")
@click.option("--timeout", type=float, default=60, show_default=True, metavar="SECONDS")
def wait_online(name: str, timeout: float) -> None:
    """Wait until the robot's tunnel is up."""
    database = open_database()
    _get(database, name)
    if wait_for(lambda: _online(database, name), timeout) is None:
        raise NotDone(f"cannot see robot {name} online after {timeout:g} s: see its agent's log")
    click.echo(f"robot {name} is online")


def _get(database: Database, name: str) -> Robot:
    with database.transaction() as tx:
        return robots.get(tx, name)


def _online(database: Database, name: str) -> bool | None:
    with database.transaction() as tx:
        return any(seen.online for seen in robots.list_all(tx) if seen.robot.name == name) or None


def _change_state(tx: Transaction, found: Robot, state: State, kind: str) -> None:
    if found.state == state:
        return
    robots.set_state(tx, found.id, state)
    audit.record(tx, SOURCE, Event(kind, found.name, {"was": found.state}))


def _as_dict(seen: SeenRobot) -> dict[str, object]:
    return {
        "name": seen.robot.name,
        "mac": seen.robot.mac,
        "state": seen.robot.state,
        "online": seen.online,
        "since": seen.since.isoformat() if seen.since else None,
        "ros_port": seen.robot.ros_port,
        "video_port": seen.robot.video_port,
        "fingerprint": seen.robot.fingerprint,
    }


def _as_cells(seen: SeenRobot) -> tuple[str, ...]:
    return (
        seen.robot.name,
        seen.robot.state,
        "yes" if seen.online else "no",
        f"{seen.since:%Y-%m-%d %H:%M:%S}" if seen.since else "never",
        seen.robot.mac,
        str(seen.robot.ros_port),
        str(seen.robot.video_port),
        seen.robot.fingerprint or "none yet",
    )

"""robotether robot ...: add, approve, disable, remove and watch robots."""

import json

import click

from robotether_server import macs
from robotether_server.cli.common import (
    SOURCE,
    NotDone,
    agree,
    open_database,
    print_fields,
    print_table,
    wait_for,
)
from robotether_server.store import Database, Transaction, audit, robots
from robotether_server.store.audit import Event
from robotether_server.store.robots import Robot, SeenRobot, State


@click.group()
def robot() -> None:
    """Add, list, approve, disable, enable, rekey and remove robots."""


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
@click.option(
    "--fingerprint",
    metavar="SHA256:...",
    help="Approve this key alone, without asking; `robotether-agent status` on the robot shows it.",
)
@click.option("--yes", is_flag=True, help="Approve whatever key came first, without asking.")
def approve(name: str, wait_for_key: float, fingerprint: str | None, yes: bool) -> None:
    """Let a pending robot in: the key that it showed becomes its own.

    Anybody who knows the robot's MAC can join in its name, so compare the key first.
    """
    database = open_database()
    wait_for(lambda: _get(database, name).fingerprint, wait_for_key)
    found = _get(database, name)
    _check_approvable(found)
    if fingerprint is not None:
        _check_fingerprint(found, fingerprint)
    elif not yes and found.state != "active":
        _ask_for_approval(found)
    with database.transaction() as tx:
        now = robots.get(tx, name)
        _check_approvable(now)
        # What was compared is what is approved, whatever happened meanwhile.
        _check_fingerprint(now, found.fingerprint or "")
        _change_state(tx, now, "active", "robot_approved")
    click.echo(f"robot {name} is active with key {found.fingerprint}")


@robot.command()
@click.argument("name")
def disable(name: str) -> None:
    """Keep a robot out, whatever its key."""
    with open_database().transaction() as tx:
        found = robots.get(tx, name)
        _change_state(tx, found, "disabled", "robot_disabled")
        if found.state == "pending":
            # Nobody approved this key, and `enable` must not do so in passing.
            robots.forget_key(tx, found.id)
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


@robot.command()
@click.argument("name")
def rekey(name: str) -> None:
    """Forget a robot's key, and end its connection; the next key that joins waits for approval.

    For a robot that got a new disk, and against somebody who joined in its name. Its ports and grants stay.
    """
    with open_database().transaction() as tx:
        found = robots.get(tx, name)
        robots.forget_key(tx, found.id)
        if found.state == "active":
            robots.set_state(tx, found.id, "pending")
        details: dict[str, object] = {"was": found.state, "fingerprint": found.fingerprint}
        audit.record(tx, SOURCE, Event("robot_rekeyed", name, details))
    click.echo(f"robot {name} has no key any more; it had {found.fingerprint or 'none'}")


@robot.command()
@click.argument("name")
@click.option("--yes", is_flag=True, help="Remove it without asking.")
def remove(name: str, yes: bool) -> None:
    """Remove a robot with its grants and its history; its MAC and ports are free again.

    Its connection ends. An agent that still runs joins anew, and waits as any unknown robot does.
    """
    database = open_database()
    found = _get(database, name)
    if not yes:
        print_fields(_identity(found))
        agree(f"remove robot {name}", "Remove it, with its grants?", "say --yes to remove it")
    with database.transaction() as tx:
        now = robots.get(tx, name)
        robots.remove(tx, now.id)
        details: dict[str, object] = {
            "was": now.state,
            "mac": now.mac,
            "fingerprint": now.fingerprint,
        }
        audit.record(tx, SOURCE, Event("robot_removed", name, details))
    click.echo(f"removed robot {name}")


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


def _check_approvable(found: Robot) -> None:
    if found.state == "disabled":
        raise NotDone(
            f"cannot approve robot {found.name}: it is disabled; "
            f"use: robotether robot enable {found.name}"
        )
    if found.fingerprint is None:
        raise NotDone(
            f"cannot approve robot {found.name}: it has not joined yet, "
            "so there is no key to approve"
        )


def _check_fingerprint(found: Robot, expected: str) -> None:
    if found.fingerprint != expected:
        raise NotDone(
            f"cannot approve robot {found.name}: its key is {found.fingerprint}, not {expected}; if that is "
            f"not the key that robotether-agent status shows on the robot, somebody else joined in its "
            f"name: robotether robot rekey {found.name}"
        )


def _ask_for_approval(found: Robot) -> None:
    print_fields(_identity(found))
    agree(
        f"approve robot {found.name}",
        "Does robotether-agent status on the robot show this very key?",
        f"compare the key {found.fingerprint} with the one that robotether-agent status shows on the "
        "robot, and give that one with --fingerprint",
    )


def _identity(found: Robot) -> list[tuple[str, str]]:
    """Return what tells a person which robot this is."""
    report, joined_at = found.report, found.joined_at
    return [
        ("robot", f"{found.name} ({found.state})"),
        ("MAC", found.mac),
        ("host name", report.hostname if report else "not joined yet"),
        ("address", report.address if report else "not joined yet"),
        ("joined", f"{joined_at:%Y-%m-%d %H:%M:%S} UTC" if joined_at else "not joined yet"),
        ("key", found.fingerprint or "none yet"),
    ]


def _change_state(tx: Transaction, found: Robot, state: State, kind: str) -> None:
    if found.state == state:
        return
    robots.set_state(tx, found.id, state)
    details: dict[str, object] = {"was": found.state, "fingerprint": found.fingerprint}
    audit.record(tx, SOURCE, Event(kind, found.name, details))


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
        "joined_at": seen.robot.joined_at.isoformat() if seen.robot.joined_at else None,
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

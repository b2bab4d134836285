"""robotether fleet run and list: what a person types."""

import logging
import sys
from pathlib import Path

import click

from robotether_server.cli.common import JSON, print_json, print_table
from robotether_server.cli.fleet import inventory, outcomes, remote, ssh_settings
from robotether_server.cli.fleet.fleet_run import Command, FleetRun, captured, to_terminal
from robotether_server.cli.fleet.outcomes import Outcome

INTERRUPTED = 130  # what a shell says of a command that Ctrl-C ended
MAX_PARALLEL = 200

ON = click.option(
    "--on",
    "patterns",
    multiple=True,
    required=True,
    metavar="GLOB",
    help="Names of robots, such as 'sim*'; may be given more than once.",
)
SSH_CONFIG = click.option(
    "--ssh-config",
    "config",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Where `robotether ssh-config` was written.  [default: ~/.ssh/config and what it includes]",
)


@click.group()
def fleet() -> None:
    """Run commands on many robots at once.

    Robots are the entries that `robotether ssh-config` printed, and what works with `ssh NAME` works here:
    the same files, keys, ssh-agent and known host keys.
    """
    # It says itself what went wrong, once, and paramiko would add a traceback.
    logging.getLogger("paramiko").setLevel(logging.CRITICAL)


@fleet.command("list")
@ON
@SSH_CONFIG
@JSON
def list_robots(patterns: tuple[str, ...], config: Path | None, as_json: bool) -> None:
    """List the robots that a pattern names, and how they are reached; connects to none."""
    chosen = inventory.choose(config, patterns)
    targets = [ssh_settings.resolve(name, config) for name in chosen]
    rows = [
        (one.name, one.user, str(one.port), f"{one.jump.host}:{one.jump.port}" if one.jump else "-")
        for one in targets
    ]
    heads = ("ROBOT", "USER", "PORT", "THROUGH")
    if as_json:
        print_json([dict(zip(map(str.lower, heads), row, strict=True)) for row in rows])
    else:
        print_table(heads, rows)


@fleet.command()
@click.argument("command", metavar="COMMAND")
@ON
@SSH_CONFIG
@click.option(
    "--parallel",
    type=click.IntRange(1, MAX_PARALLEL),
    default=20,
    show_default=True,
    help="On how many robots at a time.",
)
@click.option(
    "--timeout",
    "timeout_s",
    type=click.FloatRange(min=0, min_open=True),
    default=300,
    show_default=True,
    metavar="SECONDS",
    help="End the command on a robot where it takes longer.",
)
@click.option("--sudo", is_flag=True, help="Run it as root; sudo must ask no password.")
@click.option("--ask-sudo-password", is_flag=True, help="Ask for a password for all sudos, once.")
@click.option(
    "--accept-new",
    is_flag=True,
    help="Trust and note host keys that are not known yet; a changed one is never trusted.",
)
@JSON
def run(
    *,
    command: str,
    patterns: tuple[str, ...],
    config: Path | None,
    parallel: int,
    timeout_s: float,
    sudo: bool,
    ask_sudo_password: bool,
    accept_new: bool,
    as_json: bool,
) -> None:
    """Run COMMAND in the login shell of each robot.

    Prints each line as it comes, after its robot's name, and then a table on standard error. Exit status 0: it
    succeeded on all. Ctrl-C and a time-out end it on the robots, too. There is no standard input.

    For example: robotether fleet run 'systemctl restart ros' --on 'sim*' --on turtle --sudo
    """
    chosen = inventory.choose(config, patterns)
    password = (
        click.prompt("sudo password", hide_input=True, err=True) if ask_sudo_password else None
    )
    sudo = sudo or ask_sudo_password
    remote_command = Command(
        line=remote.on_lifeline(command, sudo=sudo, password=password is not None),
        timeout_s=timeout_s,
        config=config,
        password=password,
        accept_new=accept_new,
    )
    fleet_run = FleetRun(
        remote_command, chosen, parallel, captured if as_json else to_terminal(chosen)
    )
    found = fleet_run.run()
    if as_json:
        print_json([outcomes.as_dict(one) for one in sorted(found, key=lambda one: one.robot)])
    else:
        print_summary(found)
    if fleet_run.interrupted:
        sys.exit(INTERRUPTED)
    sys.exit(0 if all(one.ok for one in found) else 1)


def print_summary(found: list[Outcome]) -> None:
    """Print the table where it is in nobody's way who reads the robots' output."""
    click.echo(err=True)
    print_table(("ROBOT", "SECONDS", "RESULT"), outcomes.as_rows(found), err=True)
    click.echo(outcomes.verdict(found), err=True)

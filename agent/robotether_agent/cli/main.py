"""Reads the command line and the environment, and hands over to the subcommand.

The only module that reads the environment and sets the exit code.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from robotether_agent import __version__
from robotether_agent.cli.doctor import doctor
from robotether_agent.cli.forget import forget
from robotether_agent.cli.identity import identity
from robotether_agent.cli.join import join
from robotether_agent.cli.key import key
from robotether_agent.cli.run import run
from robotether_agent.cli.status import status
from robotether_agent.cli.switch import finish_switch, switch
from robotether_agent.problems import Problem
from robotether_agent.settings import DEFAULT_FILE, Settings, load, shown


@dataclass(frozen=True)
class Call:
    """What a subcommand may need: the settings, its own options, and the environment."""

    settings: Settings
    options: argparse.Namespace
    environ: Mapping[str, str]


def main(arguments: Sequence[str] | None = None, environ: Mapping[str, str] = os.environ) -> int:
    """Run the command and return its exit code."""
    options = _parser().parse_args(arguments)
    if options.command == "doctor":
        return doctor(partial(load, options.config, environ))
    try:
        settings = load(options.config, environ, needs_server=options.command not in WITHOUT_SERVER)
        return COMMANDS[options.command](Call(settings, options, environ))
    except Problem as problem:
        print(f"robotether-agent: {problem}", file=sys.stderr)
        return problem.exit_code


def _show_settings(settings: Settings) -> int:
    print("\n".join(shown(settings)))
    return 0


COMMANDS: dict[str, Callable[[Call], int]] = {
    "run": lambda call: run(call.settings, call.environ),
    "status": lambda call: status(call.settings, as_json=call.options.json),
    "join": lambda call: join(call.settings),
    "identity": lambda call: identity(call.settings, as_json=call.options.json),
    "key": lambda call: key(call.settings),
    "forget": lambda call: forget(call.settings, yes=call.options.yes),
    "switch": lambda call: switch(call.settings, call.options.directory, call.options.wait),
    "finish-switch": lambda call: finish_switch(
        call.settings,
        call.options.was,
        call.options.directory,
        call.options.state,
        call.options.wait,
    ),
    "show-settings": lambda call: _show_settings(call.settings),
}
# What an installer asks before it knows the server.
WITHOUT_SERVER = frozenset({"identity", "key", "forget"})


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="robotether-agent",
        description="Keeps this robot's tunnel to its Robotether server open.",
    )
    parser.add_argument("--version", action="version", version=f"robotether-agent {__version__}")
    parser.add_argument("--config", type=Path, help=f"settings file (usually {DEFAULT_FILE})")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    commands.add_parser("run", help="connect and stay connected; the boot service runs this")
    told = commands.add_parser("status", help="tell how the running agent is; 0 when connected")
    told.add_argument("--json", action="store_true", help="for programs")
    commands.add_parser("join", help="ask the server once: 0 active, 10 pending, 1 refused")
    commands.add_parser("doctor", help="check every step, and say what to do; 0 when all is well")
    named = commands.add_parser("identity", help="print the MAC that names this robot")
    named.add_argument("--json", action="store_true", help="for programs")
    commands.add_parser("key", help="make the robot's key if there is none, print its public half")
    gone = commands.add_parser(
        "forget", help="remove key and enrolment, so that a disk can be copied"
    )
    gone.add_argument("--yes", action="store_true", help="do not ask")
    other = commands.add_parser("switch", help="put another version in place, or go back by itself")
    other.add_argument("directory", type=Path, help="such as /opt/robotether-agent/versions/NAME")
    other.add_argument("--wait", type=float, default=60.0, metavar="S", help="usually 60 s")
    # Without a help text it is not listed: a unit starts it, no person.
    again = commands.add_parser("finish-switch")
    again.add_argument("was", type=Path)
    again.add_argument("directory", type=Path)
    again.add_argument("state")
    again.add_argument("--wait", type=float, default=60.0, metavar="S")
    commands.add_parser("show-settings", help="print the settings in force, secrets hidden")
    return parser

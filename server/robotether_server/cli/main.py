"""The command itself: its subcommands, the starts of web and migrate, and the handling of errors."""

import importlib
import logging
import os
import sys

import click

from robotether_server import __version__
from robotether_server.cli.audit_log import audit_log
from robotether_server.cli.cells import cell
from robotether_server.cli.grants import grant, revoke
from robotether_server.cli.groups_and_sites import group, site
from robotether_server.cli.robot_keys import rejected
from robotether_server.cli.robots import robot, stop
from robotether_server.cli.ssh_keys import print_ssh_config, ssh_key
from robotether_server.cli.tokens import join_token, token
from robotether_server.cli.users import add_first_admin, ensure_first_admin, user
from robotether_server.db import migrate
from robotether_server.problems import RobotetherError, StoreUnavailableError
from robotether_server.settings.server import MigrateSettings, WebSettings, in_force, load

# One process, because the database does the work; gthread, because a thread may wait for it.
GUNICORN = (
    "--bind=0.0.0.0:8000",
    "--workers=1",
    "--worker-class=gthread",
    "--threads=8",
    "--timeout=30",
    "--graceful-timeout=10",
    "--keep-alive=65",
    "--worker-tmp-dir=/tmp",
    "--no-control-socket",
    # nginx has the limits, and answers what is over them; these are over what it lets through.
    "--limit-request-line=0",
    "--limit-request-field_size=16384",
)
LOGGERS = {
    "text": (),
    "json": ("--logger-class=robotether_server.web.gunicorn_log.JsonLogger",),
}
APPLICATION = "robotether_server.web.app:start_app()"


# Where the commands are whose libraries take as long to load as all the rest: loaded only for them.
LOADED_LATE = {
    "fleet": "robotether_server.cli.fleet",
    "recording": "robotether_server.cli.recordings",
}


class Commands(click.Group):
    """The list of commands, in which some are loaded when they are asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Name all, in the order of the alphabet."""
        return sorted([*super().list_commands(ctx), *LOADED_LATE])

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Find one, None if there is no such command."""
        if module := LOADED_LATE.get(cmd_name):
            command: click.Command = getattr(importlib.import_module(module), cmd_name)
            return command
        return super().get_command(ctx, cmd_name)


@click.group(cls=Commands)
@click.version_option(__version__)
def cli() -> None:
    """Administer Robotether."""


@cli.command("show-settings")
def show_settings() -> None:
    """Print what is in force, secrets masked."""
    for name, value in in_force(os.environ).items():
        click.echo(f"{name}={value}")


@cli.command("migrate")
def run_migrate() -> None:
    """Bring the database up to date: schema and ports; with ADMIN_PASSWORD also the first admin."""
    loaded = load(MigrateSettings, os.environ)
    applied = migrate.migrate(loaded)
    if loaded.admin_password:
        add_first_admin(loaded.database, loaded.admin_password)
    click.echo(f"applied: {', '.join(applied) or 'nothing was missing'}")
    click.echo(f"ports for robots: {loaded.port_range_first} to {loaded.port_range_last}")


@cli.command("recorder")
def run_recorder() -> None:
    """Record robots, as people and robots' settings ask for."""
    # In place of this process: its libraries are not loaded for any other command.
    os.execv(sys.executable, [sys.executable, "-m", "robotether_server.recorder"])  # noqa: S606 - no shell is the point


@cli.command("web")
def run_web() -> None:
    """Serve pages and API on port 8000, after making the first admin where there is no user."""
    loaded = load(WebSettings, os.environ)
    ensure_first_admin(loaded)
    arguments = [*GUNICORN, f"--log-level={loaded.log_level}", *LOGGERS[loaded.log_format]]
    # In place of this process, so that the engine's signals reach gunicorn itself.
    os.execv(sys.executable, [sys.executable, "-m", "gunicorn", *arguments, APPLICATION])  # noqa: S606 - no shell is the point


for command in (
    audit_log,
    cell,
    grant,
    group,
    join_token,
    print_ssh_config,
    rejected,
    revoke,
    robot,
    site,
    ssh_key,
    stop,
    token,
    user,
):
    cli.add_command(command)


def main() -> None:
    """Run one command; a problem is one sentence and exit status 1."""
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")
    try:
        cli(prog_name="robotether")
    except RobotetherError as problem:
        # The sentence is for users of the site too; an admin may know which host and why.
        cause = f" ({problem.__cause__})" if isinstance(problem, StoreUnavailableError) else ""
        click.echo(f"robotether: {problem.detail}{cause}", err=True)
        sys.exit(1)
    except UnicodeError:
        # Of a file, a password or an argument, which all are text.
        click.echo("robotether: cannot read what was given: it is not UTF-8", err=True)
        sys.exit(1)

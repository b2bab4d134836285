"""robotether grant and revoke: what users may do with which robots."""

import click

from robotether_server.administration import grants
from robotether_server.cli.common import JSON, SOURCE, open_database, print_json, print_table
from robotether_server.store.grants import LEVELS, Level

GIVE = "give"


class GiveOrList(click.Group):
    """`grant list` lists; anything else is USER ROBOT LEVEL, as it was before there was a list."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Choose the command; a user called list is no reason to be in doubt."""
        asks_for_list = args[0] == "list" and all(word.startswith("-") for word in args[1:])
        return super().resolve_command(ctx, args if asks_for_list else [GIVE, *args])


@click.group(
    cls=GiveOrList,
    subcommand_metavar="USER ROBOT LEVEL | list",
    short_help="Let a user do something with a robot; list grants.",
)
def grant() -> None:
    """Let USER observe, drive or manage ROBOT, in place of an earlier grant; or list the grants.

    LEVEL is observe, drive or manage; each includes the ones before it. Admins may do everything without.
    """


@grant.command(GIVE, hidden=True)
@click.argument("user_name", metavar="USER")
@click.argument("robot_name", metavar="ROBOT")
@click.argument("level", type=click.Choice(LEVELS))
def give(user_name: str, robot_name: str, level: Level) -> None:
    """Let USER observe, drive or manage ROBOT."""
    with open_database().transaction() as tx:
        grants.grant(tx, SOURCE, user_name, robot_name, level)
    click.echo(f"user {user_name} may {level} robot {robot_name}")


@grant.command("list")
@JSON
def list_grants(as_json: bool) -> None:
    """List the grants, by user and robot."""
    with open_database().transaction() as tx:
        found = grants.list_all(tx)
    if as_json:
        print_json([{"user": one.user, "robot": one.robot, "level": one.level} for one in found])
        return
    print_table(("USER", "ROBOT", "LEVEL"), [(one.user, one.robot, one.level) for one in found])


@click.command()
@click.argument("user_name", metavar="USER")
@click.argument("robot_name", metavar="ROBOT")
def revoke(user_name: str, robot_name: str) -> None:
    """Take USER's grant for ROBOT away; what it opened ends."""
    with open_database().transaction() as tx:
        grants.revoke(tx, SOURCE, user_name, robot_name)
    click.echo(f"user {user_name} has no grant for robot {robot_name} any more")

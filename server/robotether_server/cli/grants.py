"""robotether grant and revoke: what users and groups may do with which robots, and until when."""

from collections.abc import Callable, Sequence

import click

from robotether_server import times
from robotether_server.cli.common import SOURCE, add_list, open_database, timestamp
from robotether_server.db.grants import LEVELS, Grant, list_all
from robotether_server.schemas import Level
from robotether_server.services import grants
from robotether_server.services.grants import ALL, Grantee, Scope

GIVE = "give"
Command = Callable[..., None]


class GiveOrList(click.Group):
    """`grant list` lists; anything else is who, what and LEVEL, as it was before there was a list."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Choose the command; a user called list is no reason to be in doubt."""
        asks_for_list = args[0] == "list" and all(word.startswith("-") for word in args[1:])
        return super().resolve_command(ctx, args if asks_for_list else [GIVE, *args])


def _who_and_what(command: Command) -> Command:
    """Add the words, and the options that replace USER and ROBOT."""
    for option in (
        click.option("--all", "everything", is_flag=True, help="All robots, instead of ROBOT."),
        click.option("--site", metavar="SITE", help="A site's robots, instead of ROBOT."),
        click.option("--group", metavar="GROUP", help="A group of users, instead of USER."),
        click.argument("words", metavar="[USER] [ROBOT] [LEVEL]", nargs=-1),
    ):
        command = option(command)
    return command


@click.group(
    cls=GiveOrList,
    # So that an option may come first: it is one of the hidden command's.
    context_settings={"ignore_unknown_options": True},
    subcommand_metavar="USER ROBOT LEVEL [--until END] | list",
    short_help="Give a user or a group rights on a robot; list grants.",
)
def grant() -> None:
    """Let USER observe, drive or manage ROBOT, in place of an earlier grant; or list the grants.

    LEVEL is observe, drive or manage; each includes the ones before it. Admins need no grant. Instead of
    USER: --group GROUP. Instead of ROBOT: --site SITE or --all. --until is a time such as 2026-01-31T12:00:00Z, or
    a day, at whose end in UTC the grant ends. Of several grants for a robot, the highest level counts.
    """


@grant.command(GIVE, hidden=True)
@_who_and_what
@click.option("--until", metavar="END", help="When it ends: a time, or a day in UTC.")
def give(
    words: tuple[str, ...], group: str | None, site: str | None, everything: bool, until: str | None
) -> None:
    """Add a grant."""
    grantee, scope, rest = _pair(words, group, site, everything)
    level = _level(_next(rest, "LEVEL"))
    _check_end(rest)
    ends_at = times.day_or_timestamp("--until", until, is_end=True) if until else None
    with open_database().transaction() as tx:
        grant, _ = grants.give(tx, SOURCE, grantee, scope, level, ends_at=ends_at)
    end = f" until {timestamp(grant.ends_at, '')}" if grant.ends_at else ""
    click.echo(f"{grant.holder_words} may {level} {grant.scope_words}{end}")


def _as_row(grant: Grant) -> tuple[str, str, str, str]:
    end = timestamp(grant.ends_at, "-") + (" (ended)" if grant.has_ended else "")
    return grant.holder_words, grant.scope_words, grant.level, end


add_list(
    grant,
    "List the grants, by user or group and robot or site.",
    list_all,
    ("WHO", "WHAT", "LEVEL", "UNTIL"),
    _as_row,
    as_dict=lambda record: vars(record) | {"all": record.all},
)


@click.command()
@_who_and_what
def revoke(words: tuple[str, ...], group: str | None, site: str | None, everything: bool) -> None:
    """Take USER's grant for ROBOT away; what it opened ends, unless another grant allows it.

    Instead of USER: --group GROUP. Instead of ROBOT: --site SITE or --all.
    """
    grantee, scope, rest = _pair(words, group, site, everything)
    _check_end(rest)
    with open_database().transaction() as tx:
        revoked = grants.revoke_from(tx, SOURCE, grantee, scope)
    click.echo(f"{revoked.holder_words} no longer has a grant for {revoked.scope_words}")


def _pair(
    words: Sequence[str], group: str | None, site: str | None, everything: bool
) -> tuple[Grantee, Scope, list[str]]:
    """Return subject and object, from the words in order and the options that replace one; and the other words."""
    if site is not None and everything:
        raise click.UsageError("--site and --all exclude each other.")
    rest = list(words)
    grantee = Grantee("group", group) if group is not None else Grantee("user", _next(rest, "USER"))
    if everything:
        return grantee, ALL, rest
    if site is not None:
        return grantee, Scope("site", site), rest
    return grantee, Scope("robot", _next(rest, "ROBOT")), rest


def _next(names: list[str], what: str) -> str:
    if not names:
        raise click.UsageError(f"Missing argument '{what}'.")
    return names.pop(0)


def _check_end(rest: list[str]) -> None:
    if rest:
        raise click.UsageError(f"Got unexpected extra argument ({rest[0]})")


def _level(word: str) -> Level:
    for level in LEVELS:
        if word == level:
            return level
    levels = ", ".join(map(repr, LEVELS))
    raise click.UsageError(f"Invalid value for 'LEVEL': {word!r} is not one of {levels}.")

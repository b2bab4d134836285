"""API tokens, which programs of a user log in with, and join tokens, which admit robots: made, listed, deleted."""

import datetime as dt
import secrets

from robotether_server import schemas
from robotether_server.db import Transaction, audit, credentials, join_tokens, robots, users
from robotether_server.db.audit import Source
from robotether_server.db.credentials import Token, TokenUse
from robotether_server.db.join_tokens import NOWHERE, JoinToken, Place
from robotether_server.db.users import User
from robotether_server.problems import FieldInvalidError, GrantMissingError, NotPossibleError
from robotether_server.schemas import Label
from robotether_server.services import ssh_keys
from robotether_server.services.joining import ROBOT_NAME
from robotether_server.settings.robot import Region

# Maximum number of tokens per user, so that nobody fills the table or the lists of admins.
MAX_TOKENS = 1000
# Default life of an API token, in days.
DEFAULT_DAYS = 365
MAX_DAYS = 3650
# Maximum number of uses of a join token.
MAX_USES = 10000
MAX_HOURS = 8760
# Size of the random end of an invitation's label: a robot may be invited again.
SUFFIX_BYTES = 3


def create(
    tx: Transaction,
    source: Source,
    user: User,
    name: str,
    days: int | None = None,
    *,
    only_for: TokenUse | None = None,
) -> str:
    """Make a token that ends after `days`, and return its text, which cannot be read again.

    Raises FieldInvalidError, RecordExistsError, NotPossibleError, or GrantMissingError for a program that shows a token
    itself (one that leaked would outlive its own end), and for a token of somebody who may not do what it is for.
    """
    if source.api_token is not None:
        raise GrantMissingError(
            f"cannot create token {name}: an API token makes no other; log in, or run: robotether token create"
        )
    if only_for == "metrics" and not user.is_admin:
        raise GrantMissingError(
            f"cannot create token {name}: user {user.name} is no admin, and metrics are for admins"
        )
    expires_at = tx.now() + dt.timedelta(days=days or DEFAULT_DAYS)
    schemas.check("name", name, Label)
    if len(credentials.list_tokens_of(tx, user)) >= MAX_TOKENS:
        raise NotPossibleError(
            f"cannot create token {name}: user {user.name} has {MAX_TOKENS}; delete those that are not used"
        )
    text = credentials.create_token(tx, user, name, expires_at, only_for)
    audit.record(
        tx,
        source,
        "token_created",
        user=user.name,
        token=name,
        expires_at=expires_at.isoformat(timespec="seconds"),
        **({"only_for": only_for} if only_for else {}),
    )
    return text


def delete(tx: Transaction, source: Source, token_id: int) -> Token:
    """Delete a token and return it; what it opened ends, and what it made goes with it. Raises RecordMissingError."""
    token = credentials.get_token(tx, token_id)
    for join_token_id in join_tokens.made_by(tx, token_id):
        delete_join_token(tx, source, join_token_id)
    owner = users.get(tx, token.user)
    for key_id in users.ssh_keys_made_by(tx, token_id):
        ssh_keys.delete(tx, source, owner, key_id)
    credentials.delete_token(tx, token_id)
    audit.record(tx, source, "token_deleted", user=token.user, token=token.name)
    return token


def invite(
    tx: Transaction,
    source: Source,
    robot: str | None,
    uses: int,
    expires_at: dt.datetime,
    *,
    place: Place,
    label: str | None = None,
) -> tuple[str, str]:
    """Make a join token, for a robot that asks for the name `robot` if there is one; return its label and text.

    Raises FieldInvalidError, RecordExistsError or RecordMissingError.
    """
    if robot is not None:
        _check_requested_name(tx, robot, uses)
    if label is None:
        suffix = secrets.token_hex(SUFFIX_BYTES)
        label = f"{(robot or 'robot')[: schemas.MAX_NAME_LENGTH - len(suffix) - 1]} {suffix}"
    return label, create_join_token(tx, source, label, uses, expires_at, place=place)


def _check_requested_name(tx: Transaction, robot: str, uses: int) -> None:
    """Raise FieldInvalidError for a name that the server would ignore when the robot asks for it."""
    if not ROBOT_NAME.fullmatch(robot):
        raise FieldInvalidError(
            "cannot use this name: use a-z, 0-9 and -; begin and end with a letter or digit", "name"
        )
    if uses > 1:
        raise FieldInvalidError(
            "cannot give one name to several robots: leave it empty, and rename them later", "name"
        )
    if robots.name_is_taken(tx, robot):
        raise FieldInvalidError(
            f"cannot name it {robot}: a robot has that name; if this is that robot, leave the name empty and it "
            "keeps its own",
            "name",
        )


def create_join_token(
    tx: Transaction,
    source: Source,
    name: str,
    uses: int,
    expires_at: dt.datetime,
    *,
    place: Place = NOWHERE,
) -> str:
    """Make a token and return its text, which cannot be had again.

    Raises FieldInvalidError, RecordExistsError or RecordMissingError.
    """
    schemas.check("name", name, Label)
    if place.region is not None:
        schemas.check("region", place.region, Region)
    text = join_tokens.create(
        tx,
        name,
        uses,
        expires_at,
        source.actor[: audit.MAX_ACTOR_LENGTH],
        place=place,
        api_token=source.api_token,
    )
    audit.record(
        tx,
        source,
        "join_token_created",
        token=name,
        uses=uses,
        expires_at=expires_at.isoformat(timespec="seconds"),
        **{name: value for name, value in vars(place).items() if value is not None},
    )
    return text


def delete_join_token(tx: Transaction, source: Source, token_id: int) -> JoinToken:
    """Delete a token and return it; the robots that it admitted stay. Raises RecordMissingError."""
    token = join_tokens.get(tx, token_id)
    join_tokens.delete(tx, token_id)
    audit.record(tx, source, "join_token_deleted", token=token.name, used=token.used)
    return token


def delete_join_tokens_of(tx: Transaction, source: Source, maker: str) -> None:
    """Delete all tokens that this admin made."""
    for token in join_tokens.list_all(tx):
        if token.created_by == maker:
            delete_join_token(tx, source, token.id)

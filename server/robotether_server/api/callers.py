"""Who asks the API, in one transaction with all that the request does.

Used by every handler that needs a user. What fails inside leaves nothing behind, its audit event included.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from flask import request

from robotether_server.api import auth
from robotether_server.api.context import context
from robotether_server.db import Transaction
from robotether_server.db.audit import Source
from robotether_server.db.users import User
from robotether_server.problems import GrantMissing


@dataclass(frozen=True)
class Caller:
    """A user with an open transaction; `source` is how the user signs the audit log."""

    tx: Transaction
    user: User
    source: Source


@contextmanager
def any_user() -> Iterator[Caller]:
    """Let in whoever has a login or an API token; raise LoginMissing, TokenInvalid or CSRFError."""
    with context().database.transaction() as tx:
        user = auth.api_user(tx, request)
        yield Caller(tx, user, Source(user.name, request.remote_addr))


@contextmanager
def admin() -> Iterator[Caller]:
    """Let in admins alone; raise GrantMissing, which tells the others nothing of what they asked for."""
    with any_user() as caller:
        check_admin(caller.user)
        yield caller


def check_admin(user: User) -> None:
    """Raise GrantMissing for a user who is no admin."""
    if not user.is_admin:
        raise GrantMissing(f"cannot do this as user {user.name}: it is for admins")

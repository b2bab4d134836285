"""Finds what admits a robot: an admin's login or API token, or a join token.

Used by joins and by PUT /api/v1/robots/NAME. Reveals nothing about tokens that do not hold.
"""

import datetime as dt
from dataclasses import dataclass

from robotether_server.db import Transaction, credentials
from robotether_server.db.credentials import JoinToken
from robotether_server.db.users import User
from robotether_server.problems import GrantMissing, TokenExpired, TokenInvalid

ROBOT = "robot"


@dataclass(frozen=True)
class EnrolmentCredential:
    """`actor` stands in the audit log; `token`: the join token that a use is counted of, or else `admin`."""

    actor: str
    token: JoinToken | None = None
    admin: User | None = None

    @property
    def details(self) -> dict[str, object]:
        """What the audit log has beside the actor."""
        if self.token is None:
            return {"by": "admin"}
        return {"by": "join token", "token": self.token.name}


def find(tx: Transaction, text: str) -> EnrolmentCredential:
    """Return whose token that is; raise TokenInvalid, TokenExpired or GrantMissing.

    A join token that is used up still tells who asks: a use is counted when it lets a robot in.
    """
    if text.startswith(credentials.JOIN_PREFIX):
        return EnrolmentCredential(ROBOT, token=_join_token(tx, text))
    user = credentials.find_token_user(tx, text)
    if user is None:
        raise TokenInvalid("cannot accept the token: it is unknown, expired or its user disabled")
    return of_admin(user)


def of_admin(user: User) -> EnrolmentCredential:
    """Return an admin as a credential; raise GrantMissing for another user."""
    if not user.is_admin:
        raise GrantMissing("cannot admit a robot with this token: it must be an admin's")
    return EnrolmentCredential(user.name, admin=user)


def _join_token(tx: Transaction, text: str) -> JoinToken:
    token = credentials.find_join_token(tx, text)
    if token is None:
        raise TokenInvalid("cannot accept the join token: it is unknown or deleted; make another")
    if token.expires_at <= dt.datetime.now(dt.UTC):
        raise TokenExpired(
            f"cannot accept the join token: it expired at {token.expires_at:%Y-%m-%d %H:%M} UTC; "
            "make another"
        )
    return token

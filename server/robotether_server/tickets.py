"""Signs and verifies tickets: short-lived permissions to open one WebSocket to one robot, or as one app.

Made by web, checked by the relay, which also remembers the ids that were used (docs/reference/protocols.md,
"Credentials"). Must never say more about a bad ticket than its code does.
"""

import datetime as dt
import re
import secrets
import time
from dataclasses import asdict, dataclass
from typing import Annotated, Literal

import msgspec
from itsdangerous import BadData, BadSignature, URLSafeTimedSerializer

from robotether_server.problems import TicketExpiredError, TicketForgedError, TicketMalformedError
from robotether_server.times import MAX_TICKET_AHEAD_S

Mode = Literal["observe", "drive", "app"]
CredentialKind = Literal["login", "token"]
SALT = "robotether.ticket"
# Of tickets that the stack's recorder signs for itself: web signs none of these, whoever asks.
RECORDER_SALT = "robotether.recorder"
ID_BYTES = 16
# Number of parts of a ticket: payload, time, signature.
PARTS = 3
TEXT = re.compile(r"[A-Za-z0-9_.-]+")


@dataclass(frozen=True)
class Ticket:
    """What a ticket permits, to whom, on which robot, and the login or token that asked for it.

    With mode `app` its user's app of the name `robot` connects, and there is no robot. What the ticket opens ends with
    that login or token, of which it holds what the database does.
    """

    id: str
    user_id: int
    user: str
    # None, if `remembered`: the relay finds the robot by its name; and of an app.
    robot_id: int | None
    robot: str
    mode: Mode
    credential: CredentialKind
    credential_sha256: Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{64}\Z")]
    # Signed while the database was away, for a user whom web remembered: the relay must know the credential itself.
    remembered: bool = False
    # Of a remembered one: that of the robot meant; None: of any robot of that name.
    mac: str | None = None


# Fields that a ticket has only where they say something: an older relay knows none of them.
OPTIONAL_FIELDS = frozenset({"remembered", "mac"})


def new_id() -> str:
    """Return an id that no other ticket has."""
    return secrets.token_hex(ID_BYTES)


class TicketSigner:
    """Turns tickets into text and back, with the key that web and the relay share."""

    def __init__(self, key: str, ttl_s: int, salt: str = SALT) -> None:
        self.ttl_s = ttl_s
        self._serializer = URLSafeTimedSerializer(key, salt=salt)

    def sign(self, ticket: Ticket) -> str:
        """Return the ticket as text that is safe in a URL."""
        members = asdict(ticket).items()
        fields = {name: value for name, value in members if value or name not in OPTIONAL_FIELDS}
        # A text already; the library's types allow bytes for serializers of other kinds.
        return str(self._serializer.dumps(fields))

    def verify(self, text: str) -> tuple[Ticket, dt.datetime]:
        """Return the ticket and the time of its signature, to the second.

        Raises TicketMalformedError, TicketForgedError or TicketExpiredError.
        """
        # The library skips in a signature what is not base64, and raises where text is no Unicode.
        if not TEXT.fullmatch(text):
            raise _why_unsigned(text)
        try:
            fields, issued_at = self._serializer.loads(text, return_timestamp=True)
        except BadSignature as error:
            raise _why_unsigned(text) from error
        except BadData as error:
            raise TicketMalformedError("cannot read the ticket; get a new one") from error
        age_s = int(time.time()) - issued_at.timestamp()
        if age_s > self.ttl_s:
            raise TicketExpiredError(
                f"cannot accept the ticket: it is older than {self.ttl_s} s; get a new one"
            )
        if age_s < -MAX_TICKET_AHEAD_S:
            raise TicketExpiredError(
                "cannot accept the ticket: the clock of the machine that signed it is ahead"
            )
        return _ticket(fields), issued_at


def _why_unsigned(text: str) -> TicketForgedError | TicketMalformedError:
    # A dot in front marks a compressed payload.
    if len(text.removeprefix(".").split(".")) == PARTS:
        return TicketForgedError(
            "cannot accept the ticket: this site did not sign it; get a new one"
        )
    return TicketMalformedError("cannot read the ticket; get a new one")


def _ticket(fields: object) -> Ticket:
    """Check the fields too: the same key may have signed another version's ticket."""
    problem = TicketMalformedError("cannot read the ticket: it has other fields; get a new one")
    if not isinstance(fields, dict):
        raise problem
    if fields.keys() | OPTIONAL_FIELDS != Ticket.__dataclass_fields__.keys():
        raise problem
    try:
        return msgspec.convert(fields, Ticket)
    except msgspec.ValidationError as error:
        raise problem from error

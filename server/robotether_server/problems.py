"""Everything that can go wrong by design, each with the short code that log and client both see.

Raised by every module of this package; turned into an RFC 9457 answer at the border of a request.
A detail is for the person who asked, so it must never hold a secret or another user's record.
"""

from __future__ import annotations

import os
import re
import ssl
import subprocess
from collections.abc import Sequence
from http import HTTPStatus

PROBLEM_JSON = "application/problem+json"


class RobotetherError(Exception):
    """A failure with a code for machines and a sentence for people."""

    code: str = "internal_error"
    status: int = HTTPStatus.INTERNAL_SERVER_ERROR
    # The field of a form that is wrong, if it is one field.
    field: str = ""

    def __init_subclass__(cls, *, code: str = "", status: int = 0) -> None:
        """What is not given is as in the class above."""
        if code:
            cls.code = code
        if status:
            cls.status = status

    def __init__(self, detail: str) -> None:
        super().__init__(detail)
        self.detail = detail

    def as_dict(self) -> dict[str, str | int]:
        """Return the members of an RFC 9457 problem, to be sent as PROBLEM_JSON."""
        return {
            "type": "about:blank",
            "title": HTTPStatus(self.status).phrase,
            "status": int(self.status),
            "code": self.code,
            "detail": self.detail,
        }

    @property
    def each(self) -> Sequence[RobotetherError]:
        """The problems of single fields, in the order of the form."""
        return (self,)

    @property
    def at_field(self) -> str:
        """The sentence beside the field, whose label names it: "Enter a whole number from 200 to 2000."."""
        why = self.detail.partition(": ")[2] or self.detail
        for pattern, replacement in _ASKS:
            why = pattern.sub(replacement, why)
        return why[:1].upper() + why[1:].rstrip(".") + "."


# "It must be X" asks for X.
_ASKS = (
    (re.compile(r"^it must be null or (.*)$"), r"enter \1, or leave it empty"),
    (re.compile(r"^it must be one of "), "choose one of "),
    (re.compile(r"^it must be "), "enter "),
    (re.compile(r"^fill in .*$"), "fill this in"),
)


def reason_in(error: Exception) -> str:
    """Return why a file, a program or a connection failed, in words for people: no class, no path, no object."""
    # What aiohttp's errors wrap.
    for name in ("certificate_error", "os_error"):
        error = getattr(error, name, error)
    if isinstance(error, ssl.SSLError):
        # One that no handshake raised has none.
        words = getattr(error, "verify_message", None) or getattr(error, "reason", None)
        reason = words or "no reason is known"
        return f"TLS fails: {reason.replace('_', ' ').lower()}"
    if isinstance(error, TimeoutError | subprocess.TimeoutExpired):
        return "no answer in time"
    if isinstance(error, UnicodeError):
        return "it is not text"
    status, number = getattr(error, "status", None), getattr(error, "errno", None)
    if isinstance(status, int) and status > 0:
        return f"HTTP {status}"
    if isinstance(number, int) and number > 0:
        return os.strerror(number)
    return getattr(error, "strerror", None) or "no reason is known"


class SettingsError(RobotetherError, code="settings_invalid"):
    """A variable of the environment is missing or has a value that is not allowed."""


class MigrationFailedError(RobotetherError, code="migration_failed"):
    """The database could not be brought to this version's schema."""


class StoreError(RobotetherError):
    """The database refused or could not be asked."""


class StoreUnavailableError(StoreError, code="store_unavailable", status=503):
    """The database does not answer, or is too busy; asking again later may help."""


class DeadlockError(StoreUnavailableError):
    """The database undid a transaction that blocked another one; it may be done again at once."""


class RecordExistsError(StoreError, code="record_exists", status=409):
    """A unique key would occur twice; `key` is its name."""

    def __init__(self, detail: str, key: str = "") -> None:
        super().__init__(detail)
        self.key = key
        self.field = KEYS_FIELDS.get(key, key)


# Of the unique keys that do not have the name of a form's field.
KEYS_FIELDS = {
    "api_tokens_name": "name",
    "user_ssh_keys_name": "name",
    "user_ssh_keys_fingerprint": "public_key",
}


class RecordMissingError(StoreError, code="record_missing", status=404):
    """Something that an admin named does not exist."""


class RecordRefusedError(StoreError, code="record_refused", status=422):
    """A value is not valid for its column, or a trigger refused it with a sentence."""


class UnauthorizedError(RobotetherError, status=401):
    """The caller is not known."""


class LoginMissingError(UnauthorizedError, code="login_missing"):
    """No valid login came with the request."""


class LoginFailedError(UnauthorizedError, code="login_failed"):
    """User or password is wrong; it does not say which."""


class TokenInvalidError(UnauthorizedError, code="token_invalid"):
    """The API token is unknown, expired, or its user is disabled."""


class TokenExpiredError(UnauthorizedError, code="token_expired"):
    """The join token's time is over."""


class TokenUsedUpError(UnauthorizedError, code="token_used_up"):
    """The join token has no uses left, or has admitted this key before."""


class TicketError(UnauthorizedError):
    """A ticket does not open what it was shown for."""


class TicketMissingError(TicketError, code="ticket_missing"):
    """No ticket and no login came with the request."""


class TicketMalformedError(TicketError, code="ticket_malformed"):
    """The text is no ticket at all."""


class TicketForgedError(TicketError, code="ticket_forged"):
    """The signature was not made with this site's key."""


class TicketExpiredError(TicketError, code="ticket_expired"):
    """The ticket is too old."""


class TicketUsedError(TicketError, code="ticket_used"):
    """The ticket has opened a connection already."""


class TicketForeignError(TicketError, code="ticket_foreign"):
    """The ticket is for another robot."""


class ForbiddenError(RobotetherError, status=403):
    """The caller is known, and may not do this."""


class OriginRefusedError(ForbiddenError, code="origin_refused"):
    """The page that asks comes from another site."""


class CsrfRefusedError(ForbiddenError, code="csrf_refused"):
    """A request that changes something came without the page's own token."""


class DestinationRefusedError(ForbiddenError, code="destination_refused"):
    """A page would run or apply what a robot answers."""


class GrantMissingError(ForbiddenError, code="grant_missing"):
    """The user may see the robot but not do this with it."""


class RobotDisabledError(ForbiddenError, code="robot_disabled"):
    """An admin has disabled the robot."""


class KeyRejectedError(ForbiddenError, code="key_rejected"):
    """An admin rejected this key."""


class KeyUnprovenError(ForbiddenError, code="key_unproven"):
    """The joining machine did not prove that it has the key's private half."""


class TokenRequiredError(ForbiddenError, code="token_required"):
    """Robots join with a token only."""


class RobotUnknownError(RobotetherError, code="robot_unknown", status=404):
    """There is no such robot, or none that this user may see."""


class FieldInvalidError(RobotetherError, code="field_invalid", status=422):
    """A field from outside is missing or has a wrong value; the detail names it, and `field` if it is one of a form."""

    def __init__(self, detail: str, field: str = "") -> None:
        super().__init__(detail)
        self.field = field


class FieldsInvalidError(FieldInvalidError):
    """Several fields of a form are wrong; the detail is the first one's."""

    def __init__(self, each: Sequence[FieldInvalidError]) -> None:
        super().__init__(each[0].detail, each[0].field)
        self._each = each

    @property
    def each(self) -> Sequence[RobotetherError]:
        """The problems of single fields, in the order of the form."""
        return self._each


class MacInUseError(RobotetherError, code="mac_in_use", status=409):
    """The row of this MAC holds another key."""


class KeyInUseError(RobotetherError, code="key_in_use", status=409):
    """The key belongs to the row of another MAC."""


class MacElsewhereError(RobotetherError, code="mac_elsewhere", status=409):
    """The robot is online on another machine; the caller is a copy of its disk."""


class ProtocolError(RobotetherError, code="protocol_error"):
    """A robot, a client or another cell sent what its protocol does not allow."""


class NotPossibleError(RobotetherError, code="not_possible", status=409):
    """An admin asks for what the record's present state does not allow."""


class LeaseFreeError(RobotetherError, code="lease_free", status=409):
    """Nobody drives the robot, so there is nobody to ask."""


class LeaseNotYoursError(RobotetherError, code="lease_not_yours", status=409):
    """Only the driver may answer who asks."""


class NobodyAsksError(RobotetherError, code="nobody_asks", status=409):
    """There is no question to answer or to take back."""


class AlreadyAskedError(RobotetherError, code="already_asked", status=409):
    """Somebody else waits for the control already."""


class LastAdminError(RobotetherError, code="last_admin", status=409):
    """Nobody could administer this site any more."""


class ThrottledError(RobotetherError, code="throttled", status=429):
    """Too many attempts; the next one is accepted after `retry_after_s`."""

    def __init__(self, detail: str, retry_after_s: int) -> None:
        super().__init__(detail)
        self.retry_after_s = retry_after_s


class TooManyPendingError(RobotetherError, code="too_many_pending", status=429):
    """As many robots wait for approval as may."""


class TooManyConnectionsError(RobotetherError, code="too_many_connections", status=429):
    """As many connections of this kind are open as may be, of this user or to this robot."""


class SiteCertificateUnavailableError(RobotetherError, code="front_unavailable", status=503):
    """The certificate that this site shows cannot be learnt now."""


class HistoryUnavailableError(RobotetherError, code="history_unavailable", status=503):
    """Prometheus is not there, or does not answer."""


class RobotOfflineError(RobotetherError, code="robot_offline", status=503):
    """The robot has no tunnel."""


class GuardSilentError(RobotetherError, code="guard_silent", status=504):
    """The robot is online, and its guard does not confirm."""


class ServiceTimeoutError(RobotetherError, code="service_timeout", status=504):
    """A service of the robot's ROS did not answer in time; the detail says whether it may still run."""


class TopicDownError(RobotetherError, code="topic_down", status=502):
    """The robot is online, and a topic brings nothing."""


class VideoDownError(RobotetherError, code="video_down", status=502):
    """The tunnel is there; web_video_server on the robot does not answer."""


class NoFramesError(VideoDownError, code="no_frames"):
    """web_video_server is there; the camera's topic gives no frame."""


class NoEncoderError(RobotetherError, code="no_encoder", status=409):
    """The robot sends its video in another codec than was asked for."""


# Python 3.13 took new phrases from RFC 9110; a code must not change with Python.
OLD_PHRASES = {
    413: "Request Entity Too Large",
    414: "Request-URI Too Long",
    416: "Requested Range Not Satisfiable",
    422: "Unprocessable Entity",
}


class HttpError(RobotetherError):
    """An error that HTTP itself has a status for, such as a path that does not exist."""

    def __init__(self, status: int, detail: str) -> None:
        super().__init__(detail)
        self.status = status
        phrase = OLD_PHRASES.get(status) or HTTPStatus(status).phrase
        self.code = phrase.lower().replace(" ", "_").replace("-", "_")

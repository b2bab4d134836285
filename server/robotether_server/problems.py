"""Everything that can go wrong by design, each with the short code that log and client both see.

Raised by every module of this package; turned into an RFC 9457 answer at the border of a request.
A detail is for the person who asked, so it must never hold a secret or another user's record.

Problem                       status  code
├── SettingsError             500     settings_invalid
├── MigrationFailed           500     migration_failed
├── StoreProblem
│   ├── StoreUnavailable      503     store_unavailable
│   ├── RecordExists          409     record_exists
│   ├── RecordMissing         404     record_missing
│   └── RecordRefused         422     record_refused
├── Unauthorized              401
│   ├── LoginMissing                  login_missing
│   ├── LoginFailed                   login_failed
│   ├── TokenInvalid                  token_invalid
│   ├── TokenExpired                  token_expired
│   ├── TokenUsedUp                   token_used_up
│   └── TicketProblem
│       ├── TicketMissing             ticket_missing
│       ├── TicketMalformed           ticket_malformed
│       ├── TicketForged              ticket_forged
│       ├── TicketExpired             ticket_expired
│       ├── TicketUsed                ticket_used
│       └── TicketForeign             ticket_foreign
├── Forbidden                 403
│   ├── OriginRefused                 origin_refused
│   ├── CsrfRefused                   csrf_refused
│   ├── DestinationRefused            destination_refused
│   ├── GrantMissing                  grant_missing
│   ├── RobotDisabled                 robot_disabled
│   ├── KeyRejected                   key_rejected
│   └── TokenRequired                 token_required
├── RobotUnknown              404     robot_unknown
├── FieldInvalid              422     field_invalid
├── MacInUse                  409     mac_in_use
├── KeyInUse                  409     key_in_use
├── MacElsewhere              409     mac_elsewhere
├── NotPossible               409     not_possible
├── LeaseFree                 409     lease_free
├── LeaseNotYours             409     lease_not_yours
├── NobodyAsks                409     nobody_asks
├── AlreadyAsked              409     already_asked
├── LastAdmin                 409     last_admin
├── Throttled                 429     throttled
├── TooManyPending            429     too_many_pending
├── TooManyConnections        429     too_many_connections
├── SiteCertificateUnavailable          503     front_unavailable
├── RobotOffline              503     robot_offline
├── GuardSilent               504     guard_silent
├── VideoDown                 502     video_down
└── HttpProblem               any     from the status: not_found, method_not_allowed, ...
"""

from http import HTTPStatus

PROBLEM_JSON = "application/problem+json"


class Problem(Exception):  # noqa: N818 - the word of RFC 9457 for what it renders
    """A failure with a code for machines and a sentence for people."""

    code: str = "internal_error"
    status: int = HTTPStatus.INTERNAL_SERVER_ERROR

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


class SettingsError(Problem):
    """A variable of the environment is missing or has a value that is not allowed."""

    code = "settings_invalid"


class MigrationFailed(Problem):
    """The database could not be brought to this version's schema."""

    code = "migration_failed"


class StoreProblem(Problem):
    """The database refused or could not be asked."""


class StoreUnavailable(StoreProblem):
    """The database does not answer, or is too busy; asking again later may help."""

    code = "store_unavailable"
    status = HTTPStatus.SERVICE_UNAVAILABLE


class RecordExists(StoreProblem):
    """A unique key would occur twice; `key` is its name."""

    code = "record_exists"
    status = HTTPStatus.CONFLICT

    def __init__(self, detail: str, key: str = "") -> None:
        super().__init__(detail)
        self.key = key


class RecordMissing(StoreProblem):
    """Something that an admin named does not exist."""

    code = "record_missing"
    status = HTTPStatus.NOT_FOUND


class RecordRefused(StoreProblem):
    """A value is not valid for its column, or a trigger refused it with a sentence."""

    code = "record_refused"
    status = HTTPStatus.UNPROCESSABLE_ENTITY


class Unauthorized(Problem):
    """Who asks is not known."""

    status = HTTPStatus.UNAUTHORIZED


class LoginMissing(Unauthorized):
    """No valid login came with the request."""

    code = "login_missing"


class LoginFailed(Unauthorized):
    """User or password is wrong; it does not say which."""

    code = "login_failed"


class TokenInvalid(Unauthorized):
    """The API token is unknown, expired, or its user is disabled."""

    code = "token_invalid"


class TokenExpired(Unauthorized):
    """The join token's time is over."""

    code = "token_expired"


class TokenUsedUp(Unauthorized):
    """The join token has no uses left, or has admitted this key before."""

    code = "token_used_up"


class TicketProblem(Unauthorized):
    """A ticket does not open what it was shown for."""


class TicketMissing(TicketProblem):
    """No ticket and no login came with the request."""

    code = "ticket_missing"


class TicketMalformed(TicketProblem):
    """The text is no ticket at all."""

    code = "ticket_malformed"


class TicketForged(TicketProblem):
    """The signature was not made with this site's key."""

    code = "ticket_forged"


class TicketExpired(TicketProblem):
    """The ticket is too old."""

    code = "ticket_expired"


class TicketUsed(TicketProblem):
    """The ticket has opened a connection already."""

    code = "ticket_used"


class TicketForeign(TicketProblem):
    """The ticket is for another robot."""

    code = "ticket_foreign"


class Forbidden(Problem):
    """Who asks is known and may not."""

    status = HTTPStatus.FORBIDDEN


class OriginRefused(Forbidden):
    """The page that asks comes from another site."""

    code = "origin_refused"


class CsrfRefused(Forbidden):
    """A request that changes something came without the page's own token."""

    code = "csrf_refused"


class DestinationRefused(Forbidden):
    """A page would run or apply what a robot answers."""

    code = "destination_refused"


class GrantMissing(Forbidden):
    """The user may see the robot but not do this with it."""

    code = "grant_missing"


class RobotDisabled(Forbidden):
    """An admin has disabled the robot."""

    code = "robot_disabled"


class KeyRejected(Forbidden):
    """An admin turned this key away."""

    code = "key_rejected"


class TokenRequired(Forbidden):
    """Robots join with a token only."""

    code = "token_required"


class RobotUnknown(Problem):
    """There is no such robot, or none that this user may see."""

    code = "robot_unknown"
    status = HTTPStatus.NOT_FOUND


class FieldInvalid(Problem):
    """A field from outside is missing or has a wrong value; the detail names it, and `field` if it is one of a form."""

    code = "field_invalid"
    status = HTTPStatus.UNPROCESSABLE_ENTITY

    def __init__(self, detail: str, field: str = "") -> None:
        super().__init__(detail)
        self.field = field


class MacInUse(Problem):
    """The row of this MAC holds another key."""

    code = "mac_in_use"
    status = HTTPStatus.CONFLICT


class KeyInUse(Problem):
    """The key belongs to the row of another MAC."""

    code = "key_in_use"
    status = HTTPStatus.CONFLICT


class MacElsewhere(Problem):
    """The robot is online on another machine; who asks is a copy of its disk."""

    code = "mac_elsewhere"
    status = HTTPStatus.CONFLICT


class NotPossible(Problem):
    """An admin asks for what the record's present state does not allow."""

    code = "not_possible"
    status = HTTPStatus.CONFLICT


class LeaseFree(Problem):
    """Nobody drives the robot, so there is nobody to ask."""

    code = "lease_free"
    status = HTTPStatus.CONFLICT


class LeaseNotYours(Problem):
    """Only the driver may answer who asks."""

    code = "lease_not_yours"
    status = HTTPStatus.CONFLICT


class NobodyAsks(Problem):
    """There is no question to answer or to take back."""

    code = "nobody_asks"
    status = HTTPStatus.CONFLICT


class AlreadyAsked(Problem):
    """Somebody else waits for the control already."""

    code = "already_asked"
    status = HTTPStatus.CONFLICT


class LastAdmin(Problem):
    """Nobody could administer this site any more."""

    code = "last_admin"
    status = HTTPStatus.CONFLICT


class Throttled(Problem):
    """Too many attempts; the next one is accepted after `retry_after_s`."""

    code = "throttled"
    status = HTTPStatus.TOO_MANY_REQUESTS

    def __init__(self, detail: str, retry_after_s: int) -> None:
        super().__init__(detail)
        self.retry_after_s = retry_after_s


class TooManyPending(Problem):
    """As many robots wait for approval as may."""

    code = "too_many_pending"
    status = HTTPStatus.TOO_MANY_REQUESTS


class TooManyConnections(Problem):
    """As many connections of this kind are open as may be, of this user or to this robot."""

    code = "too_many_connections"
    status = HTTPStatus.TOO_MANY_REQUESTS


class SiteCertificateUnavailable(Problem):
    """The certificate that this site shows cannot be learnt now."""

    code = "front_unavailable"
    status = HTTPStatus.SERVICE_UNAVAILABLE


class RobotOffline(Problem):
    """The robot has no tunnel."""

    code = "robot_offline"
    status = HTTPStatus.SERVICE_UNAVAILABLE


class GuardSilent(Problem):
    """The robot is online, and its guard does not confirm."""

    code = "guard_silent"
    status = HTTPStatus.GATEWAY_TIMEOUT


class VideoDown(Problem):
    """The tunnel is there; web_video_server on the robot does not answer."""

    code = "video_down"
    status = HTTPStatus.BAD_GATEWAY


# Python 3.13 took new phrases from RFC 9110; a code must not change with Python.
OLD_PHRASES = {
    413: "Request Entity Too Large",
    414: "Request-URI Too Long",
    416: "Requested Range Not Satisfiable",
    422: "Unprocessable Entity",
}


class HttpProblem(Problem):
    """An error that HTTP itself has a status for, such as a path that does not exist."""

    def __init__(self, status: int, detail: str) -> None:
        super().__init__(detail)
        self.status = status
        phrase = OLD_PHRASES.get(status) or HTTPStatus(status).phrase
        self.code = phrase.lower().replace(" ", "_").replace("-", "_")

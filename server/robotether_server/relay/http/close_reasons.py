"""Why an operator's connection ends: WebSocket close codes with reasons that a person can read.

The site's page "Codes" is made from these functions; the short names are in logs and metrics.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timezone

from robotether_server.contract.codes import CLOSE_CODES
from robotether_server.problems import RobotetherError

# Maximum size of a close reason: a control frame carries 125 bytes, two of them the code (RFC
# 6455).
MAX_REASON_BYTES = 123
MEGABYTE = 1024 * 1024


@dataclass(frozen=True)
class CloseReason:
    """A close code's name in `CLOSE_CODES`, and the sentence for the operator."""

    name: str
    reason: str

    @property
    def code(self) -> int:
        """The number in the close frame."""
        return CLOSE_CODES[self.name].number

    @property
    def reason_bytes(self) -> bytes:
        """The reason as UTF-8 that fits a close frame, cut between characters."""
        raw = self.reason.encode()[:MAX_REASON_BYTES]
        return raw.decode(errors="ignore").encode()


class ConnectionClosedError(RobotetherError):
    """Carries a close reason out of code that connects; over HTTP a problem of the same code."""

    def __init__(self, close_reason: CloseReason) -> None:
        super().__init__(close_reason.reason)
        self.close_reason = close_reason
        self.code, self.status = close_reason.name, CLOSE_CODES[close_reason.name].status


def client_left(robot: str) -> CloseReason:
    """The operator closed the connection."""
    return CloseReason("client_left", f"connection to robot {robot} closed")


def control_given_up(robot: str) -> CloseReason:
    """The driver gave up control. A client closes with this code to say so; any other says that it left."""
    return CloseReason("control_given_up", f"you gave up control of robot {robot}")


def client_vanished(robot: str) -> CloseReason:
    """The operator's connection broke; nobody reads this code."""
    return CloseReason("client_vanished", f"connection to robot {robot} broke")


def relay_stopping() -> CloseReason:
    """The relay stops; connect again."""
    return CloseReason("relay_stopping", "the relay is stopping; connect again in a moment")


def message_too_big(limit_bytes: int, sender: str) -> CloseReason:
    """A message was over `MESSAGE_LIMIT_MB` (10) from either side, or over 64 KB from an observer."""
    small = limit_bytes < MEGABYTE
    limit = f"{limit_bytes / 1024:g} KB" if small else f"{limit_bytes / MEGABYTE:g} MB"
    return CloseReason("message_too_big", f"{sender} sent a message over {limit}")


def protocol_broken(sender: str) -> CloseReason:
    """One side broke the WebSocket protocol."""
    return CloseReason("protocol_broken", f"{sender} broke the WebSocket protocol")


def relay_failed() -> CloseReason:
    """A defect of the relay; its log has the traceback."""
    return CloseReason("relay_failed", "the relay failed; connect again, and see its log")


def rights_ended(robot: str) -> CloseReason:
    """Grant, user, login or token ended, or policy, drive topics or `max_age_ms` changed.

    A new ticket shows what is left.
    """
    return CloseReason("rights_ended", f"your rights on robot {robot} have ended or changed")


def superseded(robot: str) -> CloseReason:
    """This user's newer drive connection took over."""
    return CloseReason("superseded", f"a newer connection of yours drives robot {robot} now")


def robot_stopped(robot: str, by: str, at: datetime) -> CloseReason:
    """The robot was stopped (drive connections only)."""
    why = f"{stopped_sentence(robot, by, at)}; a driver must release it"
    return CloseReason("robot_stopped", why)


def lease_held(robot: str, by: str, since: datetime | None) -> CloseReason:
    """Another user drives, or has control reserved."""
    if since is None:
        return CloseReason("lease_held", f"control of {robot} is reserved for {by}; wait a moment")
    timestamp = since.astimezone(timezone.utc).strftime("%H:%M UTC")
    why = f"{by} has been driving {robot} since {timestamp}; ask for control, or wait"
    return CloseReason("lease_held", why)


def lease_lost(robot: str, to: str) -> CloseReason:
    """Control passed to another user: handed over, passed on or taken."""
    return CloseReason("lease_lost", f"{to} controls {robot} now")


def lease_ended(robot: str) -> CloseReason:
    """A call over HTTP shared its user's lease, which ended; nobody else has control."""
    return CloseReason("lease_lost", f"the lease of robot {robot} for this call has ended")


def lease_unavailable(robot: str) -> CloseReason:
    """The database does not answer, and the robot has no guard, or your login or token was not used for 15 minutes."""
    why = f"cannot let you drive {robot}: the database does not answer; try again shortly"
    return CloseReason("lease_unavailable", why)


def cell_draining(robot: str) -> CloseReason:
    """The robot's server is taken out of service; the robot moves to another one shortly."""
    why = f"cannot let you drive {robot}: its server goes out of service; try again shortly"
    return CloseReason("lease_unavailable", why)


def called(robot: str, by: str) -> CloseReason:
    """A route may not drive while a call over HTTP does."""
    why = f"cannot let you drive {robot}: {by} calls a service of it; try again shortly"
    return CloseReason("lease_unavailable", why)


def reserved_to_help(robot: str, by: str) -> CloseReason:
    """A route may not drive while control is reserved for whoever is to help the robot."""
    why = f"cannot let you drive {robot}: it is reserved for {by}, who may help it"
    return CloseReason("lease_unavailable", why)


def client_silent(robot: str, limit_s: float) -> CloseReason:
    """No pong or message for 6 s (pings every 2 s); of a driver 2.5 s (every 0.2 s), of an app's routes 10 s."""
    why = f"you sent nothing for {limit_s:g} s; the connection to {robot} is closed"
    return CloseReason("client_silent", why)


def client_slow(robot: str, limit_s: float) -> CloseReason:
    """The client read nothing for 10 s, or was the slowest when observers had over 128 MB to read."""
    return CloseReason("client_slow", f"you did not read what robot {robot} sent for {limit_s:g} s")


def client_floods(robot: str) -> CloseReason:
    """The client sent far more than its limits, or over 100 pings and pongs a second, for 3 s."""
    return CloseReason("client_floods", f"you sent robot {robot} too much for too long")


def too_many_connections(why: str) -> CloseReason:
    """32 connections of a user or 64 observers of a robot are open; for video 32 of a user, 64 of a robot."""
    return CloseReason("too_many_connections", why)


def robot_offline(robot: str, since: datetime | None, now: datetime) -> CloseReason:
    """The robot has no tunnel."""
    return CloseReason("robot_offline", offline_sentence(robot, since, now))


def rosbridge_down(robot: str, why: str) -> CloseReason:
    """The robot is online, but rosbridge does not answer."""
    return CloseReason("rosbridge_down", f"rosbridge on robot {robot} does not answer: {why}")


def video_down(robot: str, why: str) -> CloseReason:
    """The robot's video service cannot be reached."""
    return CloseReason("video_down", f"video of {robot} is down: {why}")


def frames_unknown(robot: str) -> CloseReason:
    """The robot's agent has no frames service; clients look for the first word of the reason."""
    why = f"frames_unknown: {robot} has no frames service; upgrade its agent"
    return CloseReason("video_down", why)


def topics_unknown(robot: str) -> CloseReason:
    """The robot's agent has no topics service; a `status` says so, and the connection stays open."""
    return CloseReason("video_down", f"{robot} has no topics service; upgrade its agent")


def topics_down(robot: str, why: str) -> CloseReason:
    """The robot's topics service cannot be reached; a `status` says so, and the connection stays open."""
    return CloseReason("video_down", f"{robot} sends no topics: {why}")


def frames_broken(why: str) -> CloseReason:
    """A viewer broke the frames protocol, or sent over 200 messages a second."""
    return CloseReason("protocol_broken", f"you broke the frames protocol: {why}")


def link_lost(robot: str) -> CloseReason:
    """The tunnel went down during the connection, or the line to the robot's server (observers only)."""
    return CloseReason("link_lost", f"the link to robot {robot} is lost")


def stopped_sentence(robot: str, by: str, at: datetime) -> str:
    """Say who stopped a robot, and when."""
    timestamp = at.astimezone(timezone.utc).strftime("%H:%M UTC")
    return f"{by} stopped {robot} at {timestamp}"


def offline_sentence(robot: str, since: datetime | None, now: datetime) -> str:
    """Say since when a robot is offline; the day only when it is not today (UTC)."""
    if since is None:
        return f"robot {robot} is offline: it has not connected yet"
    since, now = since.astimezone(timezone.utc), now.astimezone(timezone.utc)
    layout = "%H:%M UTC" if since.date() == now.date() else "%Y-%m-%d %H:%M UTC"
    return f"robot {robot} has been offline since {since.strftime(layout)}"

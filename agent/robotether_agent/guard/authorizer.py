"""Decides who may drive now, by key, fence, stop, session and the agent's ticks. Pure.

It is asked at each handshake and again for each command, so that a right that ended is gone at once. The newest number
that anybody showed counts, in this session or before: the lease's line and the driver's handshake come on two channels,
in either order. An older number never counts.
"""

from __future__ import annotations

import hmac
import re
from collections.abc import Mapping

from robotether_common.guard import FENCE_HEADER, FENCE_REFUSED, KEY_HEADER, MODE_HEADER
from robotether_common.session import MAX_FENCE

from robotether_agent.guard.drive_messages import DriveMessageRefusedError
from robotether_agent.guard.topics import Authorization
from robotether_agent.problems import DetailError

AGENT_SILENT_S = 1.0
FENCE = re.compile("[0-9]{1,19}")


class DriveNotAuthorizedError(DetailError):
    """A handshake gets the HTTP `status` and this text."""

    def __init__(self, status: int, why: str) -> None:
        super().__init__(why)
        self.status = status


class Authorizer:
    """Decides who may drive now, by what the agent has reported of rights."""

    def __init__(self, now: float, fence: int = 0) -> None:
        """Begin with the newest number of the guard before this one, which nobody holds."""
        self.key = ""
        self.direct = False
        self.stopped = False
        self.exiting = False
        self.fence = fence
        self._held = False
        self._session = False
        self._agent_at = now

    @property
    def silent_at(self) -> float:
        """When the agent counts as silent."""
        return self._agent_at + AGENT_SILENT_S

    def on_agent_message(self, now: float) -> None:
        """Note that the agent is alive."""
        self._agent_at = now

    def session(self, *, up: bool) -> None:
        """Note that the session with the server is up, or is lost."""
        if not up:
            self._held = False
        self._session = up

    def lease(self, fence: int, *, held: bool) -> None:
        """Note the server's newest number; not `held`: it and all before it are over."""
        if fence > self.fence:
            self.fence, self._held = fence, held
        elif fence == self.fence and not held:
            self._held = False

    def stop(self) -> None:
        """Stop the robot, which ends the lease."""
        self.stopped, self._held = True, False

    def release(self) -> None:
        """Let the next lease drive."""
        self.stopped = False

    def authorize(self, headers: Mapping[str, str]) -> Authorization:
        """Return what a handshake may do, or raise DriveNotAuthorizedError."""
        key = headers.get(KEY_HEADER)
        if key is None and self.direct:
            return Authorization("direct")
        if not self.key or not hmac.compare_digest(_bytes(key), _bytes(self.key)):
            raise DriveNotAuthorizedError(
                403, "cannot join rosbridge: only the server may, with its key"
            )
        if headers.get(MODE_HEADER) == "observe":
            return Authorization("observe")
        if headers.get(MODE_HEADER) != "drive":
            raise DriveNotAuthorizedError(
                403, f"cannot join rosbridge: {MODE_HEADER} is neither drive nor observe"
            )
        return self._authorize_driver(_fence(headers.get(FENCE_HEADER, "")))

    def check(self, authorization: Authorization, fence: object, now: float) -> None:
        """Raise DriveMessageRefusedError unless a drive message with this `fence` may move the robot now."""
        if self.stopped:
            raise DriveMessageRefusedError(
                "stopped", "the robot is stopped; a driver must release it"
            )
        if self.exiting or not self._session or now >= self.silent_at:
            raise DriveMessageRefusedError(
                "held", "the robot's agent or its session with the server is down"
            )
        if not self.holds(authorization):
            raise DriveMessageRefusedError(
                "fence", "somebody else has control, or your control has ended"
            )
        if authorization.mode == "drive" and (
            type(fence) is not int or fence != authorization.fence
        ):
            raise DriveMessageRefusedError(
                "fence", "its fence is not that of the connection's lease"
            )

    def holds(self, authorization: Authorization) -> bool:
        """Return whether a connection's right to drive still holds, apart from holds that pass."""
        if authorization.mode == "direct":
            return self.direct and not self._held
        return authorization.mode == "drive" and self._held and authorization.fence == self.fence

    def keeps(self, authorization: Authorization) -> bool:
        """Return whether a connection may stay: a driver whose lease is over may do nothing more."""
        if authorization.mode == "direct":
            return self.direct and self._session
        return authorization.mode == "observe" or self.holds(authorization)

    def _authorize_driver(self, fence: int) -> Authorization:
        if self.stopped:
            raise DriveNotAuthorizedError(FENCE_REFUSED, "cannot drive: the robot is stopped")
        if not self._session or self.exiting:
            raise DriveNotAuthorizedError(
                FENCE_REFUSED, "cannot drive: the robot's session with the server is down"
            )
        if fence > self.fence:
            self.fence, self._held = fence, True
        if fence != self.fence or not self._held:
            raise DriveNotAuthorizedError(FENCE_REFUSED, f"cannot drive: lease {fence} is over")
        return Authorization("drive", fence)


def _bytes(key: str | None) -> bytes:
    return (key or "").encode(errors="surrogateescape")


def _fence(text: str) -> int:
    if FENCE.fullmatch(text) and 0 < int(text) <= MAX_FENCE:
        return int(text)
    raise DriveNotAuthorizedError(403, f"cannot drive: {FENCE_HEADER} is not a number of a lease")

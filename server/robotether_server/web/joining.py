"""Lets robots in: decides what a robot that shows a MAC and a key is told.

Used by api/join.py. A MAC only names a robot; its key is what proves it. Without a token JOIN_POLICY says
what becomes of a new key. A join proves no possession of the key, so one with a key that is known already
must never change the row, and only the old key's signature or an admin changes the key of an active robot.
"""

import datetime as dt
from dataclasses import dataclass
from typing import Literal

from robotether_server import macs
from robotether_server.administration import enrolment, vouching
from robotether_server.administration.enrolment import Shown
from robotether_server.administration.vouching import Vouch
from robotether_server.networks import network_of
from robotether_server.problems import (
    MacElsewhere,
    RobotDisabled,
    TokenRequired,
    TokenUsedUp,
    TooManyPending,
)
from robotether_server.settings import JoinSettings
from robotether_server.store import Transaction, audit, claims, locks, robots, sessions
from robotether_server.store.audit import Event, Source
from robotether_server.store.robots import Robot
from robotether_server.web.rotation import PreviousKey, rotate

# What nobody announced: how much one network may leave waiting, and for how long.
STRANGERS_PER_NETWORK = 10
STRANGER_LIFETIME = dt.timedelta(hours=24)
# A join proves nothing, so it may not fill the audit log either.
MAC_CHANGED_EVERY = dt.timedelta(hours=24)


@dataclass(frozen=True)
class Request:
    """What a robot asks. `mac_present` False: it keeps a MAC that none of its interfaces has."""

    shown: Shown
    token: str | None = None
    name: str | None = None
    mac_present: bool = True
    previous: PreviousKey | None = None


@dataclass(frozen=True)
class Answer:
    """What it is told: `robot` is its name, or the one that its MAC alone would give it."""

    robot: str
    code: Literal["active", "approval_pending", "mac_in_use"]
    detail: str = ""


def is_in(tx: Transaction, request: Request) -> Answer | None:
    """Answer a robot that is active with this key; every robot asks so at every start, all at once.

    Takes no lock and changes nothing; None: `join` decides. The token is not looked at.
    """
    robot = robots.peek_by_mac(tx, request.shown.mac)
    if robot is None or robot.state != "active" or not request.mac_present:
        return None
    return _active(robot) if robot.fingerprint == request.shown.key.fingerprint else None


def join(tx: Transaction, request: Request, rules: JoinSettings) -> Answer:
    """Answer a robot after writing down what is new; must be the first deed in its transaction.

    Raises FieldInvalid, TokenInvalid, TokenExpired, TokenUsedUp, TokenRequired, GrantMissing, RobotDisabled,
    KeyRejected, KeyInUse, MacElsewhere, TooManyPending or StoreUnavailable.
    """
    locks.enrolment(tx)
    _forget_old(tx)
    shown = request.shown
    enrolment.check_not_rejected(tx, shown.key)
    robot = robots.find_by_mac(tx, shown.mac)
    if robot is not None:
        is_known = robot.fingerprint == shown.key.fingerprint
        _check_not_disabled(robot, shown, is_known=is_known)
        if is_known and robot.state == "active":
            return _still_active(tx, request, robot)
        if request.previous is not None and rotate(tx, robot, shown, request.previous):
            return _active(robot)
    vouch = _vouch(tx, request, rules)
    source = Source(vouch.actor if vouch else vouching.ROBOT, shown.report.address)
    return _Joining(tx, source, request, rules, vouch).decide(robot)


@dataclass(frozen=True)
class _Joining:
    """One join of a robot that is not in yet, with what the deciding needs."""

    tx: Transaction
    source: Source
    request: Request
    rules: JoinSettings
    vouch: Vouch | None

    def decide(self, robot: Robot | None) -> Answer:
        """Let the key in, let it wait, or note that it claims another key's place."""
        enrolment.check_key_is_free(
            self.tx, self.source, self.request.shown, vouched=self.vouch is not None
        )
        if robot is None:
            robot = self._add()
        holds_other = robot.fingerprint not in (None, self.request.shown.key.fingerprint)
        if holds_other and (robot.state == "active" or self.vouch is None):
            return self._claim(robot)
        if self.vouch is not None or self._is_first_key(robot):
            return _active(
                enrolment.let_in(self.tx, self.source, robot, self.request.shown, self.vouch)
            )
        return self._wait(robot)

    def _add(self) -> Robot:
        """Add a row for a MAC that nobody knows."""
        mac = self.request.shown.mac
        if not self.rules.allow_local_macs:
            macs.check_universal(mac)
        if self.vouch is None:
            self._check_room()
        name = enrolment.free_name(self.tx, mac, self.request.name if self.vouch else None)
        robots.add(self.tx, mac, name, stranger=self.vouch is None)
        return robots.get(self.tx, name)

    def _is_first_key(self, robot: Robot) -> bool:
        is_open = not robot.is_stranger and not robot.had_key
        return self.rules.policy == "first-key" and is_open

    def _wait(self, robot: Robot) -> Answer:
        shown = self.request.shown
        if robot.fingerprint != shown.key.fingerprint:
            enrolment.take_key(self.tx, robot, shown)
            # The key is new, so it waits even in a row that was active without one.
            robots.set_state(self.tx, robot.id, "pending")
            audit.record(self.tx, self.source, Event("robot_pending", robot.name, _details(shown)))
        return Answer(
            robot.name,
            "approval_pending",
            f"robot {robot.name} waits for approval; an admin approves it with: "
            f"robotether robot approve {robot.name}",
        )

    def _claim(self, robot: Robot) -> Answer:
        """Note the key beside the robot, which goes on with its own. The asker learns nothing of that robot."""
        shown = self.request.shown
        if claims.find(self.tx, shown.key.fingerprint) is None:
            self._check_room()
            claims.add(self.tx, robot, shown.key, shown.report)
            audit.record(self.tx, self.source, Event("key_claimed", robot.name, _details(shown)))
        return Answer(
            next(enrolment.usual_names(shown.mac)),
            "mac_in_use",
            f"a robot with MAC {shown.mac} and another key is known and goes on with that one; an admin "
            f"decides about this key, {shown.key.fingerprint}, in the page of waiting robots",
        )

    def _check_room(self) -> None:
        """Raise TooManyPending when all, or one network, have as much waiting as may."""
        waiting = robots.strangers(self.tx)
        waiting += [claim.report.address for claim in claims.waiting(self.tx)]
        network = network_of(self.request.shown.report.address)
        from_there = sum(network_of(other) == network for other in waiting)
        is_crowded = from_there >= STRANGERS_PER_NETWORK
        whose = f"{from_there} from {network}" if is_crowded else f"{len(waiting)}"
        if is_crowded or len(waiting) >= self.rules.max_pending:
            raise TooManyPending(
                f"cannot take another unknown robot: {whose} wait for approval already; an admin approves or "
                "rejects some, or lets this one in beforehand with: robotether robot add NAME --mac MAC"
            )


def _forget_old(tx: Transaction) -> None:
    before = dt.datetime.now(dt.UTC) - STRANGER_LIFETIME
    robots.remove_strangers(tx, before)
    claims.remove_old(tx, before)


def _check_not_disabled(robot: Robot, shown: Shown, *, is_known: bool) -> None:
    if robot.state != "disabled":
        return
    if not is_known:
        raise RobotDisabled(
            f"cannot join with MAC {shown.mac}: its robot is disabled; ask an admin"
        )
    raise RobotDisabled(
        f"cannot join robot {robot.name}: it is disabled; an admin enables it with: "
        f"robotether robot enable {robot.name}"
    )


def _still_active(tx: Transaction, request: Request, robot: Robot) -> Answer:
    if not request.mac_present:
        _check_moved(tx, request, robot)
    return _active(robot)


def _check_moved(tx: Transaction, request: Request, robot: Robot) -> None:
    """Note that a robot lost its MAC, or raise MacElsewhere: it is at work, so who asks is its copy."""
    if sessions.is_online(tx, robot.id):
        raise MacElsewhere(
            f"cannot join with MAC {robot.mac}: this machine does not have it, and its robot is online; this is a "
            "copy of that robot's disk, and must join with its own MAC and a new key"
        )
    last = audit.find(tx, audit.Search(robot.name, kind="mac_changed"), limit=1)
    if last and last[0].at > dt.datetime.now(dt.UTC) - MAC_CHANGED_EVERY:
        return
    source = Source(vouching.ROBOT, request.shown.report.address)
    audit.record(tx, source, Event("mac_changed", robot.name, _details(request.shown)))


def _vouch(tx: Transaction, request: Request, rules: JoinSettings) -> Vouch | None:
    """Return who vouches for a robot that is not in yet; None: nobody, so it may only wait."""
    vouch = vouching.find(tx, request.token) if request.token else None
    if vouch is not None and not enrolment.is_spent(tx, vouch, request.shown.key):
        return vouch
    if rules.policy != "token-only":
        return None
    if vouch is not None:
        raise TokenUsedUp(
            "cannot join with this token: it has let this key in before, and an admin has undone that; "
            "get another token"
        )
    raise TokenRequired(
        "cannot join without a token: this server takes no other robots (JOIN_POLICY=token-only); an admin makes "
        "one with: robotether robot invite"
    )


def _active(robot: Robot) -> Answer:
    return Answer(robot.name, "active")


def _details(shown: Shown) -> dict[str, object]:
    return {
        "mac": shown.mac,
        "fingerprint": shown.key.fingerprint,
        "hostname": shown.report.hostname,
    }

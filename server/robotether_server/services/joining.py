"""Decides what becomes of the key that a robot joins with, or that a playbook brings (robots.py).

A MAC only names a robot; its key is what proves it, and a machine signs with the new key that it brings: nobody enrols
the key of another; an admin's word for a key is enough. Without a credential JOIN_POLICY says what becomes of a
new key, mostly it waits, and nothing that waits may keep a robot out that comes with a credential. A join with a known
key must never change the row, and only the old key's signature (`rotate`) or an admin changes the key of an active
robot.
"""

import datetime as dt
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain, count
from typing import Literal

from robotether_common.join import (
    JOIN_NAMESPACE,
    ROTATION_NAMESPACE,
    PreviousKey,
    join_message,
    rotation_message,
)

from robotether_server import identity
from robotether_server.db import Transaction, audit, credentials, join_tokens, robots, seen_robots
from robotether_server.db.audit import Source, network_of
from robotether_server.db.join_tokens import JoinToken, Place
from robotether_server.db.robots import Claim, Report, RobotRow
from robotether_server.db.users import User
from robotether_server.identity import PublicKey
from robotether_server.problems import (
    FieldInvalidError,
    GrantMissingError,
    KeyInUseError,
    KeyRejectedError,
    KeyUnprovenError,
    MacElsewhereError,
    RobotDisabledError,
    TokenExpiredError,
    TokenInvalidError,
    TokenRequiredError,
    TokenUsedUpError,
    TooManyPendingError,
)
from robotether_server.services import grants
from robotether_server.services.grants import Grantee, Scope
from robotether_server.settings.robot import put_path
from robotether_server.settings.server import JoinSettings
from robotether_server.signatures import is_signed

# Maximum number of unannounced robots and keys that wait per network, and time for which they wait.
MAX_UNKNOWN_PER_NETWORK = 10
UNKNOWN_ROBOT_LIFETIME = dt.timedelta(hours=24)
# Minimum interval between audit lines of a changed MAC: an active robot proves nothing here and
# must not fill the log.
MAC_CHANGED_EVERY = dt.timedelta(hours=24)
# With a robot of the name localhost, people's `ssh localhost` and playbooks would reach that in place of their machine.
ROBOT_NAME = re.compile(r"(?!localhost\Z)(?=.{1,63}\Z)[a-z0-9]([a-z0-9-]*[a-z0-9])?")
MIN_SUFFIX_LENGTH = 6
MAC_DIGITS = 12
# Who acts in the audit log when a robot joins.
ROBOT = "robot"


@dataclass(frozen=True)
class EnrolmentCredential:
    """`actor` is for the audit log; `token`: the join token that a use is counted of, or else `admin`."""

    actor: str
    token: JoinToken | None = None
    admin: User | None = None

    @property
    def details(self) -> dict[str, object]:
        """What the audit log has beside the actor."""
        if self.token is None:
            return {"by": "admin"}
        return {"by": "join token", "token": self.token.name}


@dataclass(frozen=True)
class PresentedKey:
    """What a robot shows and says: its MAC (normalised), its key, and about itself."""

    mac: str
    key: PublicKey
    report: Report


@dataclass(frozen=True)
class JoinAttempt:
    """What a robot asks. `mac_present` False: it keeps a MAC that none of its interfaces has.

    `signature`: of the key that it presents.
    """

    presented: PresentedKey
    token: str | None = None
    name: str | None = None
    mac_present: bool = True
    previous: PreviousKey | None = None
    signature: str | None = None


@dataclass(frozen=True)
class Answer:
    """What it is answered: `robot` is its name, or the one that its MAC alone would give it.

    `robot_id` and `region` of a robot that is active.
    """

    robot: str
    code: Literal["active", "approval_pending", "mac_in_use"]
    detail: str = ""
    robot_id: int = field(default=0, compare=False)
    region: str | None = None


def is_in(tx: Transaction, request: JoinAttempt) -> Answer | None:
    """Answer a robot that is active with this key; every robot asks so at every start, all at once.

    Takes no lock and changes nothing; None: `join` decides. The token is not looked at.
    """
    robot = robots.peek_by_mac(tx, request.presented.mac)
    if robot is None or robot.state != "active" or not request.mac_present:
        return None
    return _active(robot) if robot.fingerprint == request.presented.key.fingerprint else None


def is_proven(presented: PresentedKey, signature: str | None, token: str | None = None) -> bool:
    """Return whether who asks has the private half of the key."""
    message = join_message(token, presented.mac, presented.key.line)
    return signature is not None and is_signed(
        presented.key.line, JOIN_NAMESPACE, message, signature
    )


def check_proven(presented: PresentedKey, *, is_proven: bool) -> None:
    """Raise KeyUnprovenError."""
    if not is_proven:
        raise KeyUnprovenError(
            f"cannot join with key {presented.key.fingerprint}: the request has no signature by it over token, MAC and "
            "key; an agent that is older than this server makes none: install this server's"
        )


def join(tx: Transaction, request: JoinAttempt, rules: JoinSettings, *, is_proven: bool) -> Answer:
    """Answer a robot after writing down what is new; must be the first action in its transaction.

    Raises FieldInvalidError, KeyUnprovenError, TokenInvalidError, TokenExpiredError, TokenUsedUpError,
    TokenRequiredError, GrantMissingError, RobotDisabledError, KeyRejectedError, KeyInUseError, MacElsewhereError,
    TooManyPendingError or StoreUnavailableError.
    """
    robots.lock_enrolment(tx)
    too_old = tx.now() - UNKNOWN_ROBOT_LIFETIME
    robots.remove_unknown(tx, too_old)
    robots.remove_old_claims(tx, too_old)
    presented = request.presented
    check_not_rejected(tx, presented.key)
    robot = _robot_of(tx, request)
    if robot is not None:
        is_known = robot.fingerprint == presented.key.fingerprint
        _check_not_disabled(robot, presented, is_known=is_known)
        if is_known and robot.state == "active":
            if not request.mac_present:
                _check_moved(tx, request, robot)
            return _active(robot)
        if request.previous is not None and rotate(tx, robot, presented, request.previous):
            return _active(robot)
    check_proven(presented, is_proven=is_proven)
    credential = _credential_of(tx, request, rules)
    source = Source(credential.actor if credential else ROBOT, presented.report.address)
    return _Joining(tx, source, request, rules, credential).decide(robot)


@dataclass(frozen=True)
class _Joining:
    """One join of a robot that is not in yet, with what the deciding needs."""

    tx: Transaction
    source: Source
    request: JoinAttempt
    rules: JoinSettings
    credential: EnrolmentCredential | None

    def decide(self, robot: RobotRow | None) -> Answer:
        """Let the key in, let it wait, or note that it claims another key's place."""
        check_key_is_free(
            self.tx, self.source, self.request.presented, is_authorized=self.credential is not None
        )
        if robot is None:
            robot = self._add()
        holds_other = robot.fingerprint not in (None, self.request.presented.key.fingerprint)
        if holds_other and (robot.state == "active" or self.credential is None):
            return self._claim(robot)
        if self.credential is not None or self._is_first_key(robot):
            return _active(
                admit(self.tx, self.source, robot, self.request.presented, self.credential)
            )
        return self._wait(robot)

    def _add(self) -> RobotRow:
        """Add a row for a MAC that nobody knows."""
        mac = self.request.presented.mac
        if not self.rules.allow_local_macs:
            identity.check_universal_mac(mac)
        if self.credential is None:
            self._check_room()
        name = free_name(self.tx, mac, self.request.name if self.credential else None)
        robots.add(self.tx, mac, name, unknown=self.credential is None)
        return robots.get(self.tx, name)

    def _is_first_key(self, robot: RobotRow) -> bool:
        is_open = not robot.is_unknown and not robot.had_key
        return self.rules.policy == "first-key" and is_open

    def _wait(self, robot: RobotRow) -> Answer:
        presented = self.request.presented
        if robot.fingerprint != presented.key.fingerprint:
            adopt_key(self.tx, robot, presented)
            # The key is new, so it waits even in a row that was active without one.
            robots.set_state(self.tx, robot.id, "pending")
            audit.record(self.tx, self.source, "robot_pending", robot.name, **_details(presented))
        return Answer(
            robot.name,
            "approval_pending",
            f"robot {robot.name} waits for approval; an admin approves it with: "
            f"robotether robot approve {robot.name}",
        )

    def _claim(self, robot: RobotRow) -> Answer:
        """Note the key beside the robot, which goes on with its own. The asker learns nothing of that robot."""
        presented = self.request.presented
        if robots.find_claim(self.tx, presented.key.fingerprint) is None:
            self._check_room()
            robots.add_claim(self.tx, robot, presented.key, presented.report)
            audit.record(self.tx, self.source, "key_claimed", robot.name, **_details(presented))
        return Answer(
            next(usual_names(presented.mac)),
            "mac_in_use",
            f"the robot with MAC {presented.mac} has another key and keeps it; an admin "
            f"decides about this key, {presented.key.fingerprint}, on the page that adds robots",
        )

    def _check_room(self) -> None:
        """Raise TooManyPendingError when all, or one network, have as much waiting as may."""
        waiting = robots.waiting_addresses(self.tx)
        network = network_of(self.request.presented.report.address)
        from_there = sum(network_of(other) == network for other in waiting)
        is_crowded = from_there >= MAX_UNKNOWN_PER_NETWORK
        addresses = f"{from_there} from {network}" if is_crowded else f"{len(waiting)}"
        if is_crowded or len(waiting) >= self.rules.max_pending:
            raise TooManyPendingError(
                f"cannot admit another unknown robot: {addresses} already wait for approval; an admin approves or "
                "rejects some, or announces this one with: robotether robot add NAME --mac MAC"
            )


def _check_not_disabled(robot: RobotRow, presented: PresentedKey, *, is_known: bool) -> None:
    if robot.state != "disabled":
        return
    if not is_known:
        raise RobotDisabledError(
            f"cannot join with MAC {presented.mac}: its robot is disabled; ask an admin"
        )
    raise RobotDisabledError(
        f"cannot join robot {robot.name}: it is disabled; an admin enables it with: "
        f"robotether robot enable {robot.name}"
    )


def _robot_of(tx: Transaction, request: JoinAttempt) -> RobotRow | None:
    """Return the robot of the MAC, or of the key where the machine has lost that MAC.

    An admin may have given the robot its new network card's, or the old card to another robot, which nobody told it.
    """
    by_mac = robots.find_by_mac(tx, request.presented.mac)
    if request.mac_present:
        return by_mac
    by_key = robots.find_by_key(tx, request.presented.key.fingerprint)
    if by_key is None and request.previous is not None:
        by_key = robots.find_by_key(tx, request.previous.fingerprint)
    return by_key if by_key is not None and by_key.state == "active" else by_mac


def _check_moved(tx: Transaction, request: JoinAttempt, robot: RobotRow) -> None:
    """Note that a robot lost its MAC, or raise MacElsewhereError: it is at work, so who asks is its copy."""
    if seen_robots.is_online(tx, robot.id):
        raise MacElsewhereError(
            f"cannot join with MAC {request.presented.mac}: this machine does not have it, and its robot is online; "
            "this is a copy of that robot's disk, and must join with its own MAC and a new key"
        )
    last = audit.find(tx, audit.AuditSearch(robot.name, kind="mac_changed"), limit=1)
    if last and last[0].at > tx.now() - MAC_CHANGED_EVERY:
        return
    source = Source(ROBOT, request.presented.report.address)
    audit.record(tx, source, "mac_changed", robot.name, **_details(request.presented))


def _credential_of(
    tx: Transaction, request: JoinAttempt, rules: JoinSettings
) -> EnrolmentCredential | None:
    """Return the credential of a robot that is not in yet; None: it has none, so it may only wait."""
    credential = find_credential(tx, request.token) if request.token else None
    if credential is not None and not is_spent(tx, credential, request.presented.key):
        return credential
    if rules.policy != "token-only":
        return None
    if credential is not None:
        raise TokenUsedUpError(
            "cannot join with this token: it has admitted this key before, and an admin has undone that; "
            "get another token"
        )
    raise TokenRequiredError(
        "cannot join without a token: this server requires one (JOIN_POLICY=token-only); an admin makes "
        "one with: robotether robot invite"
    )


def find_credential(tx: Transaction, text: str) -> EnrolmentCredential:
    """Return whose token that is; raise TokenInvalidError, TokenExpiredError or GrantMissingError.

    A join token that is used up still says who asks: a use is counted when it admits a robot.
    """
    if text.startswith(join_tokens.PREFIX):
        return EnrolmentCredential(ROBOT, token=_join_token(tx, text))
    return credential_of_admin(credentials.get_token_user(tx, text))


def credential_of_admin(user: User) -> EnrolmentCredential:
    """Return an admin as a credential; raise GrantMissingError for another user."""
    if not user.is_admin:
        raise GrantMissingError("cannot admit a robot with this token: it must be an admin's")
    return EnrolmentCredential(user.name, admin=user)


def _join_token(tx: Transaction, text: str) -> JoinToken:
    token = join_tokens.find(tx, text)
    if token is None:
        raise TokenInvalidError(
            "cannot accept the join token: it is unknown or deleted; make another"
        )
    if token.expires_at <= tx.now():
        raise TokenExpiredError(
            f"cannot accept the join token: it expired at {token.expires_at:%Y-%m-%d %H:%M} UTC; "
            "make another"
        )
    return token


def _active(robot: RobotRow) -> Answer:
    return Answer(robot.name, "active", robot_id=robot.id, region=robot.region)


def rotate(
    tx: Transaction, robot: RobotRow, presented: PresentedKey, previous: PreviousKey
) -> bool:
    """Put the new key in place of the one that signed it; False: the robot is not active with that one.

    Must never change a key that did not sign. Raises FieldInvalidError for a wrong signature, and KeyInUseError.
    """
    old = robot.key
    if old is None or robot.state != "active" or previous.fingerprint != old.fingerprint:
        return False
    message = rotation_message(presented.mac, presented.key.line)
    if not is_signed(old.line, ROTATION_NAMESPACE, message, previous.signature):
        raise FieldInvalidError(
            f"cannot use previous_key: its signature is not by key {old.fingerprint} over this MAC and the "
            "new key"
        )
    source = Source(ROBOT, presented.report.address)
    check_key_is_free(tx, source, presented, is_authorized=True)
    claim = robots.find_claim(tx, presented.key.fingerprint)
    if claim is not None:
        robots.remove_claim(tx, claim.id)
    robots.rotate_key(tx, robot.id, presented.key)
    audit.record(
        tx,
        source,
        "key_rotated",
        robot.name,
        was=old.fingerprint,
        fingerprint=presented.key.fingerprint,
    )
    return True


def check_not_rejected(tx: Transaction, key: PublicKey) -> None:
    """Raise KeyRejectedError for a key that an admin rejected."""
    claim = robots.find_claim(tx, key.fingerprint)
    if claim is not None and claim.is_rejected:
        raise KeyRejectedError(
            f"cannot join with key {key.fingerprint}: an admin rejected it; make a new key on the robot "
            "(sudo robotether-agent forget), or ask an admin to remove it from the list of rejected keys"
        )


def check_key_is_free(
    tx: Transaction, source: Source, presented: PresentedKey, *, is_authorized: bool
) -> None:
    """Raise KeyInUseError when the key is at another MAC; where it only waits there, an authorized robot gets it."""
    holder = robots.find_by_key(tx, presented.key.fingerprint)
    claim = robots.find_claim(tx, presented.key.fingerprint)
    waits_elsewhere = holder is not None and holder.mac != presented.mac
    claimed_elsewhere = claim is not None and claim.mac != presented.mac
    if not waits_elsewhere and not claimed_elsewhere:
        return
    if not is_authorized or (waits_elsewhere and holder is not None and holder.state != "pending"):
        raise KeyInUseError(
            f"cannot join with MAC {presented.mac}: the key belongs to a robot with another MAC; "
            "make a new key on this one"
        )
    _release(tx, source, holder, claim)


def admit(
    tx: Transaction,
    source: Source,
    robot: RobotRow,
    presented: PresentedKey,
    credential: EnrolmentCredential | None,
) -> RobotRow:
    """Make the key the robot's own, and the robot active; None: JOIN_POLICY admits first keys.

    Raises TokenUsedUpError; a use of a join token is counted here and nowhere else.
    """
    if credential is not None and credential.token is not None:
        _count_use(tx, credential.token, presented.key)
    adopt_key(tx, robot, presented)
    robots.set_state(tx, robot.id, "active")
    audit.record(
        tx,
        source,
        "robot_approved",
        robot.name,
        was=robot.state,
        mac=presented.mac,
        fingerprint=presented.key.fingerprint,
        hostname=presented.report.hostname,
        **(credential.details if credential else {"by": "first key"}),
    )
    if credential is not None and credential.token is not None:
        _put_in_place(tx, source, robot, join_tokens.place_of(tx, credential.token.id))
    return robots.get(tx, robot.name)


def _put_in_place(tx: Transaction, source: Source, robot: RobotRow, place: Place) -> None:
    """Follow the token's place where an admin has not said another for this robot."""
    if place.site is not None and robot.site is None:
        grants.place_robot(tx, source, robot.name, place.site)
    group, scope = Grantee("group", place.group or ""), Scope("robot", robot.name)
    if place.group is not None and not grants.is_given(tx, group, scope):
        grants.give(tx, source, group, scope, "drive")
    if place.region is not None and robot.region is None:
        settings = put_path(robot.settings, "region", place.region)
        robots.set_settings(tx, robot.id, settings)
        audit.record(
            tx,
            source,
            "robot_settings_set",
            robot.name,
            was=robot.settings,
            settings=settings,
        )


def adopt_key(tx: Transaction, robot: RobotRow, presented: PresentedKey) -> None:
    """Write the key into the row, unless it is there: a known key changes nothing."""
    claim = robots.find_claim(tx, presented.key.fingerprint)
    if claim is not None:
        robots.remove_claim(tx, claim.id)
    if robot.fingerprint == presented.key.fingerprint:
        return
    robots.set_key(tx, robot.id, presented.key, presented.report)


def is_spent(tx: Transaction, credential: EnrolmentCredential, key: PublicKey) -> bool:
    """Return whether the join token admitted this key before, and an admin has undone that since."""
    return credential.token is not None and join_tokens.has_admitted(
        tx, credential.token.id, key.fingerprint
    )


def free_name(tx: Transaction, mac: str, requested: str | None) -> str:
    """Return the requested name if it can be had, or robot- and as many of the MAC's digits as make it a new name."""
    requested_names = (
        [requested] if requested is not None and ROBOT_NAME.fullmatch(requested) else []
    )
    names = chain(requested_names, usual_names(mac))
    return next(name for name in names if not robots.name_is_taken(tx, name))


def usual_names(mac: str) -> Iterator[str]:
    """Return names for an unknown robot, the shortest first; there is always another."""
    digits = mac.replace(":", "")
    for length in range(MIN_SUFFIX_LENGTH, MAC_DIGITS + 1):
        yield f"robot-{digits[-length:]}"
    for number in count(2):
        yield f"robot-{digits}-{number}"


def _count_use(tx: Transaction, token: JoinToken, key: PublicKey) -> None:
    if join_tokens.has_admitted(tx, token.id, key.fingerprint):
        raise TokenUsedUpError(
            f"cannot join with this token: it has admitted key {key.fingerprint} before, and an admin has undone "
            "that; get another token, or an admin's approval"
        )
    if not join_tokens.use(tx, token.id, key.fingerprint):
        raise TokenUsedUpError(
            f"cannot join with this token: it was good for {token.uses} "
            f"{'robot' if token.uses == 1 else 'robots'}, and has admitted them; get another"
        )


def _release(tx: Transaction, source: Source, holder: RobotRow | None, claim: Claim | None) -> None:
    if claim is not None:
        robots.remove_claim(tx, claim.id)
    if holder is None:
        return
    if holder.is_unknown:
        robots.remove(tx, holder.id)
    else:
        robots.forget_key(tx, holder.id)
    audit.record(
        tx, source, "key_released", holder.name, mac=holder.mac, fingerprint=holder.fingerprint
    )


def _details(presented: PresentedKey) -> dict[str, object]:
    return {
        "mac": presented.mac,
        "fingerprint": presented.key.fingerprint,
        "hostname": presented.report.hostname,
    }

"""/api/v1/join: a robot's request at its first start, and while it is not admitted."""

import threading
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Literal

from flask import request
from msgspec import UNSET, Meta, Struct, UnsetType
from robotether_common.join import PreviousKey

from robotether_server import identity
from robotether_server.api.context import context
from robotether_server.api.operations import operation
from robotether_server.db import cells
from robotether_server.db.cells import SshAddresses
from robotether_server.db.robots import Reason, Report
from robotether_server.problems import RobotetherError, StoreUnavailableError, ThrottledError
from robotether_server.schemas import (
    AgentVersion,
    Hostname,
    Mac,
    PublicKeyLine,
    RobotName,
    Signature,
)
from robotether_server.services import joining, pending
from robotether_server.services.joining import PresentedKey
from robotether_server.settings.server import JoinSettings

SSH_USER = "tunnel"
KEY_WORDS = 2
# Maximum number of joins that change something at once: they wait for each other in the database, each in a thread of
# web, which has eight. Agents ask again.
MAX_AT_ONCE = 4
THROTTLED_S = 1
_places = threading.BoundedSemaphore(MAX_AT_ONCE)


class GivenPreviousKey(Struct):
    """The robot's previous key, when it rotates its key.

    `signature`: `ssh-keygen -Y sign -n robotether-rotation` with it over "MAC NEW_PUBLIC_KEY" and a newline.
    Connections of the previous key stay; new log-ins need the new one.
    """

    fingerprint: Annotated[str, Meta(extra={"longest": 64})]
    signature: Signature


class RobotJoin(Struct):
    """A robot's request. Unknown members are ignored, as an agent may be newer than this server.

    `token`: a join token, or an API token of an admin. It activates the robot and replaces a key that waits, never an
    active robot's. A robot that is active with this key needs none, and none is checked. A join token admits each key
    once: a robot removed or rekeyed since waits as if without token (token_used_up if the server requires tokens).
    `signature`: `ssh-keygen -Y sign -n robotether-join` with the key over "TOKEN MAC PUBLIC_KEY" and a newline (`-`
    without token; the key as `ssh-ed25519 AAAA...`). Only a robot that is active with this key, or rotates it, needs
    none. `name` counts only with a token and for a new MAC, if it is free and valid. `mac_present` false: no interface
    has this MAC any more; if its robot is online, this is a copied disk (409 mac_elsewhere), else the same robot.
    `host_key_refused`: SSH here shows another host key than the robot has pinned, so it does not connect; pages say so
    until the robot joins or connects again.
    """

    mac: Mac
    public_key: PublicKeyLine
    hostname: Hostname
    agent_version: AgentVersion
    token: Annotated[str, Meta(extra={"longest": 200})] | UnsetType | None = UNSET
    name: Annotated[str, Meta(extra={"longest": 253})] | UnsetType | None = UNSET
    signature: Signature | UnsetType | None = UNSET
    mac_present: bool | UnsetType | None = UNSET
    host_key_refused: bool | UnsetType | None = UNSET
    previous_key: GivenPreviousKey | UnsetType | None = UNSET


class SshOfCell(Struct):
    """Where a machine of the site accepts tunnels."""

    host: str
    ports: list[int]


class Ssh(Struct):
    """Where the robot's tunnel goes; `host` null: the host of this request. `host_keys`: TYPE BASE64, to be pinned.

    `cells`: the machines of the site, the one to try first in front; without it there is `host` alone.
    """

    user: str
    host: str | None
    ports: list[int]
    host_keys: list[str]
    cells: list[SshOfCell] | UnsetType = UNSET


class JoinedRobot(Struct):
    """The robot is active."""

    state: Literal["active"]
    robot: RobotName
    ssh: Ssh


class WaitingRobot(Struct):
    """The robot waits for approval.

    `mac_in_use`: the MAC's robot has another key, and an admin decides about this one; `robot` is the name that the MAC
    alone would give.
    """

    state: Literal["pending"]
    robot: RobotName
    code: Reason
    detail: str


class SshServer(Struct):
    """Where robots connect; a robot's doctor tries that before it is in."""

    ssh: Ssh


@operation("GET", "/ssh", "anybody")
def get_ssh() -> SshServer:
    """Show where robots connect."""
    return SshServer(ssh_of(context().join))


@operation("POST", "/join", "anybody", any_type=True, problems=(409,))
def join(body: RobotJoin) -> tuple[JoinedRobot, Literal[200]] | tuple[WaitingRobot, Literal[202]]:
    """Ask for admission as a robot."""
    attempt = _attempt(body)
    with context().database.transaction() as tx:
        answer, site_cells = joining.is_in(tx, attempt), cells.read(tx)
        if answer is not None and body.host_key_refused is True:
            detail = pending.host_key_refused(answer.robot)
            pending.record_refusal(tx, attempt.presented, "host_key_changed", detail)
        elif answer is not None:
            pending.forget_refusals(tx, attempt.presented)
    if answer is None:
        answer = _join(attempt)
    if answer.code == "active":
        addresses = cells.sort_for_join(answer.robot_id, site_cells, region=answer.region)
        return JoinedRobot("active", answer.robot, ssh_of(context().join, addresses)), 200
    return WaitingRobot("pending", answer.robot, answer.code, answer.detail), 202


def _join(attempt: joining.JoinAttempt) -> joining.Answer:
    if not _places.acquire(blocking=False):
        raise ThrottledError(
            "cannot join now: too many robots join at this moment; try again shortly", THROTTLED_S
        )
    try:
        # Before the lock that all who join wait for.
        is_proven = joining.is_proven(attempt.presented, attempt.signature, attempt.token)
        with context().database.transaction() as tx:
            answer = joining.join(tx, attempt, context().join, is_proven=is_proven)
            pending.forget_refusals(tx, attempt.presented)
            return answer
    except StoreUnavailableError:
        raise
    except RobotetherError as problem:
        with context().database.transaction() as tx:
            pending.record_refusal(tx, attempt.presented, problem.code, problem.detail)
        raise
    finally:
        _places.release()


def _attempt(body: RobotJoin) -> joining.JoinAttempt:
    previous = body.previous_key or None
    return joining.JoinAttempt(
        presented=PresentedKey(
            mac=identity.normalise_mac(body.mac),
            key=identity.parse_robots_key(body.public_key),
            report=Report(body.hostname, body.agent_version, request.remote_addr or ""),
        ),
        token=body.token or None,
        name=body.name or None,
        signature=body.signature or None,
        mac_present=body.mac_present is not False,
        previous=previous and PreviousKey(previous.fingerprint, previous.signature),
    )


def ssh_of(settings: JoinSettings, addresses: Iterable[SshAddresses] = ()) -> Ssh:
    """Return where a robot's tunnel goes, and the keys that it pins; raise StoreUnavailableError."""
    host_keys = read_host_keys(settings.ssh_host_keys_dir)
    listed = [SshOfCell(address.host, list(address.ports)) for address in addresses]
    ports = list(settings.ssh_ports)
    return Ssh(SSH_USER, settings.public_host, ports, host_keys, listed or UNSET)


def read_host_keys(folder: Path) -> list[str]:
    """Return each key as `TYPE BASE64`, by file name; raise StoreUnavailableError when there is none."""
    lines = []
    for path in sorted(folder.glob("*.pub")):
        words = path.read_text(encoding="ascii").split()
        if len(words) >= KEY_WORDS:
            lines.append(" ".join(words[:KEY_WORDS]))
    if not lines:
        raise StoreUnavailableError(
            f"cannot read sshd's host keys: {folder} has no *.pub file yet; try again shortly"
        )
    return lines

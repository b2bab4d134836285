"""Makes sure that this robot is enrolled: its key, its MAC, the join, the kept answer, the pinned host keys.

Used by the agent before each connection, and by `robotether-agent join`. An enrolled robot connects
without asking, so that it comes up fast and while the web is down; the server is asked again only when a
connection gave a reason to, or when this machine may be a copy of the robot. The answer is kept in the state
directory, and the host keys beside it in known_hosts; remove that file and the robot joins, and pins, again.
"""

from __future__ import annotations

import asyncio
import json
import logging
import re
import socket
from contextlib import nullcontext
from dataclasses import asdict, astuple, dataclass, replace
from pathlib import Path
from time import monotonic

from robotether_common.join import (
    JOIN_NAMESPACE,
    ROTATION_NAMESPACE,
    PreviousKey,
    join_message,
    rotation_message,
)

from robotether_agent import __version__
from robotether_agent.backoff import Repeats
from robotether_agent.enrolment import keys
from robotether_agent.enrolment.identity import IDENTITY_FILE, Identity, IdentityStore
from robotether_agent.enrolment.join import (
    Joined,
    JoinRequest,
    SshAccess,
    join,
    join_token,
    parse_ssh,
)
from robotether_agent.enrolment.keys import HostKey, KeyPair
from robotether_agent.fields import (
    MAC,
    ROBOT_NAME,
    FieldError,
    JsonObject,
    ListedCell,
    get_match,
    get_object,
    parse_object,
)
from robotether_agent.files import (
    LOCK,
    disk_problem,
    ensure_directory,
    only_one,
    read_text,
    write_atomic,
)
from robotether_agent.problems import (
    AgentError,
    AlreadyRunningError,
    AnswerInvalidError,
    JoinRefusedError,
    ServerUnreachableError,
    SettingsInvalidError,
    StateUnusableError,
    TlsUntrustedError,
)
from robotether_agent.settings import Settings
from robotether_agent.tasks import within

ENROLMENT_FILE = "enrolment.json"
SERVER = re.compile(r"\S{1,300}")
# Tokens expire, and a token file may be gone after the first join: an enrolled robot's key needs none.
TOKEN_USELESS = frozenset(
    {"settings_invalid", "token_invalid", "token_expired", "token_used_up", "grant_missing"}
)
# The server will never take this key: another one has to be made.
NEXT_KEY_USELESS = frozenset({"key_rejected", "key_in_use"})
# Faults of the web, or of this robot's own files: what was pinned is enough for the tunnel.
HARMLESS_ONCE_ENROLLED = (
    ServerUnreachableError,
    TlsUntrustedError,
    AnswerInvalidError,
    SettingsInvalidError,
    StateUnusableError,
)
# Minimum interval between requests for the server's address: servers rarely move, and one whose
# sshd is down gets requests from its whole fleet.
ASK_ADDRESS_EVERY_S = 60.0
# Time limit for a join of an enrolled robot; joins of many robots take turns of up to 3 s at the
# server.
QUICK_ANSWER_S = 4.0
# What the robot signed of the server's audit log (tunnel/audit_heads.py).
AUDIT_HEADS_FILE = "audit_heads.json"
# The private keys first: whatever stops this half-way, the machine has then ceased to be that robot.
FILES = (
    keys.NAME,
    keys.NEXT,
    f"{keys.NAME}.pub",
    f"{keys.NEXT}.pub",
    ENROLMENT_FILE,
    keys.KNOWN_HOSTS,
    IDENTITY_FILE,
    AUDIT_HEADS_FILE,
)

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Enrolment:
    """An active robot: its name, the MAC it joined with, and the server that it belongs to."""

    server: str
    robot: str
    mac: str
    ssh: SshAccess


class EnrolmentStore:
    """The two files in `state_dir` that make an enrolled robot."""

    def __init__(self, state_dir: Path) -> None:
        self.known_hosts = state_dir / keys.KNOWN_HOSTS
        self._file = state_dir / ENROLMENT_FILE

    def load(self, server: str) -> Enrolment | None:
        """Return the enrolment at `server`, or None: never joined, or with another server."""
        enrolment = self._read()
        if (
            enrolment is None
            or enrolment.server != server
            or not keys.pinned_host_keys(self.known_hosts)
        ):
            return None
        return enrolment

    def keep(self, enrolment: Enrolment, host_keys: list[HostKey]) -> None:
        """Keep `enrolment`; pin `host_keys` if nothing is pinned for this server yet, else compare."""
        before = keys.pinned_host_keys(self.known_hosts)
        if before and not self.is_of_other_server(enrolment.server):
            keys.check_host_keys(self.known_hosts, before, host_keys)
        else:
            keys.pin_host_keys(self.known_hosts, host_keys)
        self.write(enrolment)

    def write(self, enrolment: Enrolment, *, lasts: bool = True) -> None:
        """Write `enrolment` if it is another one than before."""
        text = json.dumps(asdict(enrolment), indent=1) + "\n"
        if text != read_text(self._file):
            write_atomic(self._file, text, 0o644, lasts=lasts)

    def is_of_other_server(self, server: str) -> bool:
        """Return whether the settings name another server now than when the robot was enrolled."""
        enrolment = self._read()
        return enrolment is not None and enrolment.server != server

    def _read(self) -> Enrolment | None:
        try:
            return _parse_enrolment(parse_object(read_text(self._file) or "", ENROLMENT_FILE))
        except FieldError:
            # A broken file is as good as none: the server is asked again, and the pin still holds.
            return None


def _parse_enrolment(obj: JsonObject) -> Enrolment:
    return Enrolment(
        server=get_match(obj, "server", SERVER, "a host"),
        robot=get_match(obj, "robot", ROBOT_NAME, "a robot's name"),
        mac=get_match(obj, "mac", MAC, "a MAC address"),
        ssh=parse_ssh(get_object(obj, "ssh")),
    )


class Enroller:
    """The way from a fresh robot to an enrolment."""

    def __init__(self, settings: Settings, root: Path = Path("/")) -> None:
        self._settings = settings
        self._store = EnrolmentStore(settings.state_dir)
        self._identities = IdentityStore(settings, root)
        self._doubted = False
        self._asked_at = -ASK_ADDRESS_EVERY_S
        # Whether the server knows since this start that the robot's MAC is on no interface of this machine.
        self._absence_reported = False
        self._absence_logged = False
        self._repeats = Repeats()
        self._asking = asyncio.Lock()
        # The newest name and list of the session, which the disk may not have taken.
        self._robot = ""
        self._cells: tuple[ListedCell, ...] = ()
        self.known_hosts = self._store.known_hosts

    async def key(self) -> KeyPair:
        """Return the robot's key, made now if there is none."""
        return await keys.ensure_key(self._state_dir())

    async def proof(self) -> str:
        """Return the key's signature over MAC and key, for a playbook that brings the three to the server."""
        key = await self.key()
        message = join_message(None, self.identity().mac, key.public)
        return await keys.sign(key, JOIN_NAMESPACE, message)

    async def next_key(self) -> KeyPair | None:
        """Return the key that is about to replace the other one, if a change has begun."""
        return await keys.next_key(self._settings.state_dir)

    def identity(self) -> Identity:
        """Return the MAC that names this robot, and whether this machine has it."""
        self._state_dir()
        enrolment = self._store.load(self._settings.server)
        identity = self._identities.identity(enrolment.mac if enrolment else None)
        if not identity.is_present and not self._absence_logged:
            log.warning(
                "no interface of this machine has the MAC %s (%s had it): this stays the same robot, and the "
                "server is asked first; a copied disk becomes a robot of its own with: sudo robotether-agent forget",
                identity.mac,
                identity.interface or "another interface",
            )
        self._absence_logged = not identity.is_present
        return identity

    async def enrolment(self) -> Enrolment:
        """Return what is known, or what the server answers to a join."""
        identity = self.identity()
        enrolment = self._kept_enrolment()
        # Only the server can tell a new network card from a copied disk.
        may_be_copy = not (identity.is_present or self._absence_reported)
        usable = enrolment is not None and enrolment.mac == identity.mac and not may_be_copy
        # A change of keys that was cut short is brought to its end first.
        asks = self._doubted or await self.next_key() is not None
        if enrolment is not None and usable and not asks:
            return enrolment
        if enrolment is None or not usable:
            return await self.join()
        try:
            # A web that does not answer must not keep a robot waiting whose tunnel may soon be up.
            return await within(QUICK_ANSWER_S, self.join())
        except HARMLESS_ONCE_ENROLLED as problem:
            self._repeats.log_problem("join", problem)
        except asyncio.TimeoutError:
            log.debug("the web did not answer in %g s: using the kept enrolment", QUICK_ANSWER_S)
            self._doubted = False
        return enrolment

    def follow(self, robot: str, cells: tuple[ListedCell, ...]) -> None:
        """Keep the robot's name and the server's newest list of its cells, if that is not empty.

        A disk that takes nothing must not cost the session.
        """
        cells = cells or self._cells
        # Two cells are the same whatever their ranks.
        are_same = [astuple(cell) for cell in cells] == [astuple(cell) for cell in self._cells]
        if are_same and robot == self._robot:
            return
        self._robot, self._cells = robot, cells
        try:
            if (enrolment := self._kept_enrolment()) is not None:
                # Not synced: somebody may drive, and the guard stops a robot whose agent waits for a slow disk.
                self._store.write(enrolment, lasts=False)
        except StateUnusableError as problem:
            self._repeats.log_problem("name and list of cells", problem)

    async def refresh(self) -> None:
        """Ask where the server is now, for as long as it takes; what goes wrong is only reported."""
        try:
            await self.join()
        except AgentError as problem:
            self._repeats.log_problem("join", problem)

    async def report_host_key(self) -> None:
        """Let the server's web know that this robot refuses the host key of its SSH, as far as it can be reached."""
        try:
            request = replace(
                self._request(self.identity(), await self.key()), host_key_refused=True
            )
            await within(QUICK_ANSWER_S, join(self._settings, request))
        except (AgentError, asyncio.TimeoutError) as error:
            log.debug("cannot report the rejected host key to the server: %s", error)

    async def join(self) -> Enrolment:
        """Ask the server now and keep its answer; a host key that is not the pinned one is raised."""
        # One at a time: a key that changes between two questions would come back as an unknown robot's.
        async with self._asking:
            return await self._join()

    async def rotate(self) -> None:
        """Give the robot another key, which the server takes in exchange for the old one."""
        key = await self.key()
        coming = await keys.ensure_next_key(self._settings.state_dir)
        log.info("the robot gets a new key: %s in place of %s", coming.fingerprint, key.fingerprint)
        await self.join()

    def doubt(self) -> None:
        """Ask the server before the next connection: what it knows of this robot may have changed."""
        self._doubted = True

    def doubt_address(self) -> None:
        """Ask before the next connection where the server is, unless it was asked within the last minute."""
        if monotonic() - self._asked_at >= ASK_ADDRESS_EVERY_S:
            self.doubt()

    def _kept_enrolment(self) -> Enrolment | None:
        """Return the kept enrolment with the newest name and list of cells."""
        enrolment = self._store.load(self._settings.server)
        if enrolment is None:
            return None
        ssh = replace(enrolment.ssh, cells=self._cells or enrolment.ssh.cells)
        return replace(enrolment, robot=self._robot or enrolment.robot, ssh=ssh)

    def _state_dir(self) -> Path:
        ensure_directory(self._settings.state_dir, "state_dir", 0o700)
        return self._settings.state_dir

    async def _join(self) -> Enrolment:
        self._asked_at = monotonic()
        settings, identity = self._settings, self.identity()
        before = self._store.load(settings.server)
        answer = await self._ask(identity, is_enrolled=before is not None)
        if self._store.is_of_other_server(settings.server):
            log.warning(
                "the settings name another server now, %s: pinning its host keys", settings.server
            )
        enrolment = Enrolment(settings.server, answer.robot, identity.mac, answer.ssh)
        self._store.keep(enrolment, answer.host_keys)
        self._robot, self._cells = "", ()
        self._doubted = False
        self._absence_reported = not identity.is_present
        self._repeats.forget()
        if enrolment != before:
            log.info(
                "%s knows this robot as %s (MAC %s)", settings.server, answer.robot, identity.mac
            )
        return enrolment

    async def _ask(self, identity: Identity, *, is_enrolled: bool) -> Joined:
        """Join with the next key if there is one; else with the token, if it is of use."""
        key = await self.key()
        request = self._request(identity, key)
        coming = await self.next_key()
        if coming is not None:
            return await self._ask_with_next(request, key, coming)
        try:
            token = join_token(self._settings)
            name = self._settings.name if token else None
            request = replace(request, token=token, name=name)
            return await join(self._settings, await _signed(request, key))
        except (SettingsInvalidError, JoinRefusedError) as problem:
            if not is_enrolled or problem.code not in TOKEN_USELESS:
                raise
            self._repeats.log_problem("join without the token", problem)
        request = replace(request, token=None, name=None)
        return await join(self._settings, await _signed(request, key))

    @staticmethod
    def _request(identity: Identity, key: KeyPair) -> JoinRequest:
        return JoinRequest(
            mac=identity.mac,
            public_key=key.public,
            hostname=socket.gethostname(),
            agent_version=__version__,
            mac_present=identity.is_present,
        )

    async def _ask_with_next(self, request: JoinRequest, key: KeyPair, coming: KeyPair) -> Joined:
        """Join with the key that is to replace `key`; also after a power cut between any two of these steps."""
        message = rotation_message(request.mac, coming.public)
        proof = PreviousKey(key.fingerprint, await keys.sign(key, ROTATION_NAMESPACE, message))
        request = replace(request, public_key=coming.public, previous_key=proof)
        try:
            answer = await join(self._settings, await _signed(request, coming))
        except JoinRefusedError as problem:
            if problem.code in NEXT_KEY_USELESS:
                keys.discard_next(self._settings.state_dir)
            raise
        try:
            await keys.promote(self._settings.state_dir)
            log.info("the server has the robot's new key %s", coming.fingerprint)
        except StateUnusableError as problem:
            # Both keys are shown to the server until the disk takes the change.
            log.warning("%s", problem)
        return answer


async def _signed(request: JoinRequest, key: KeyPair) -> JoinRequest:
    """Return the request with the proof that this robot has the key that it presents."""
    message = join_message(request.token, request.mac, request.public_key)
    return replace(request, signature=await keys.sign(key, JOIN_NAMESPACE, message))


def enrolment_files(state_dir: Path) -> list[Path]:
    """Return what there is to forget."""
    try:
        return [path for path in (state_dir / name for name in FILES) if path.exists()]
    except OSError as error:
        raise StateUnusableError(
            f"cannot read {state_dir}: {error.strerror}", advice="run this with sudo"
        ) from error


def unenrol(settings: Settings) -> None:
    """Remove all of it; raise AlreadyRunningError while an agent holds the run directory's lock."""
    lock = settings.run_dir / LOCK
    try:
        # Without the lock file nothing runs: systemd removes the directory with the service.
        with only_one(lock) if lock.exists() else nullcontext():
            for path in enrolment_files(settings.state_dir):
                path.unlink()
    except AlreadyRunningError as problem:
        raise AlreadyRunningError(
            "cannot forget this robot: its agent runs",
            advice="stop it first: sudo systemctl stop robotether-agent",
        ) from problem
    except OSError as error:
        what = f"cannot forget this robot: cannot remove {error.filename}"
        raise disk_problem(what, settings.state_dir, error, advice="run this with sudo") from error

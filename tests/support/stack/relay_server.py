"""The real relay in the test's own process, on ports of its own, with records that tests can change.

`MemoryDatabase` stands in for the database where a test is not about it: it can be taken away and
brought back at once. Whole-path tests give the relay the records of a real MariaDB.
"""

from __future__ import annotations

import asyncio
import os
import secrets
import sys
from collections.abc import AsyncIterator, Callable, Collection, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace
from datetime import datetime, timezone
from subprocess import CompletedProcess

from commands import run_command
from fake_robot import FINGERPRINT, HOST, WAIT_S
from local_network import free_port
from robotether_server import __version__
from robotether_server.db.cells import Cell, CellCounts
from robotether_server.db.control import NewLease, Stop, StoredControl
from robotether_server.db.fleet import (
    Changes,
    Credential,
    Entry,
    RelayRequest,
    RelayRobot,
    RelayUser,
    SessionEntry,
    Snapshot,
)
from robotether_server.db.routes import RelayRoute, RouteEnd
from robotether_server.problems import StoreUnavailableError
from robotether_server.relay.auth.credentials import credential_of
from robotether_server.relay.cells.keys import PeerKeys
from robotether_server.relay.http.timing import LivenessLimits
from robotether_server.relay.options import Listen, Timing
from robotether_server.relay.records.database import RelayDatabase
from robotether_server.relay.records.journal import Journal
from robotether_server.relay.wiring import Relay
from robotether_server.schemas import Level
from robotether_server.settings.server import (
    CellSettings,
    DatabaseSettings,
    RelaySettings,
    TicketSettings,
)
from robotether_server.tickets import CredentialKind, Mode, Ticket, TicketSigner

SESSION_KEY = "the session key of the tests, long enough"
TICKET_KEY = "the ticket key of the tests, long enough"
MESSAGE_LIMIT = 10 * 1024 * 1024
ANN, BOB, BEN, CARL, EVE = (
    RelayUser(number, name) for number, name in enumerate(("ann", "bob", "ben", "carl", "eve"), 1)
)

# A client that does not read for a while, and so answers no ping, is neither silent nor slow.
_NEVER = LivenessLimits(
    ping_every_s=0.1, silent_after_s=WAIT_S, slow_after_s=WAIT_S, check_every_s=0.05
)
# Short enough for tests, and longer than a shared machine stands still.
FAST = Timing(
    limits=_NEVER,
    driver_limits=replace(_NEVER, strict=True),
    heartbeat_s=0.1,
    idle_heartbeat_s=0.1,
    timeout_s=4,
    poll_every_s=0.05,
)
# For those that are to be, and robots that are to time out.
IMPATIENT = replace(
    FAST,
    timeout_s=2,
    limits=replace(FAST.limits, silent_after_s=2, slow_after_s=2),
    driver_limits=replace(FAST.driver_limits, silent_after_s=2, slow_after_s=2),
)


class MemoryDatabase(RelayDatabase):
    def __init__(self) -> None:
        self.robots: dict[int, RelayRobot] = {}
        self.grants: dict[tuple[int, int], Level] = {}
        self.credentials: dict[Credential, RelayUser] = {}
        self.seen: list[tuple[int, datetime, str | None]] = []
        self.written: list[Entry] = []
        self.down = False
        self.lookups = 0
        self.fences: dict[int, int] = {}
        self.stops: list[Stop] = []
        self.cells: dict[str, Cell] = {}
        self.requests: list[RelayRequest] = []
        self.routes: list[RelayRoute] = []

    def add_robot(self, robot_id: int, name: str, **grants: Level) -> RelayRobot:
        """Add an active robot with free ports, and grants as `u1="drive"`."""
        ports = (free_port(), free_port())
        mac = f"02:00:00:00:00:{robot_id:02x}"
        robot = RelayRobot(robot_id, name, "active", *ports, mac, fingerprint=FINGERPRINT)
        self.robots = {**self.robots, robot_id: robot}
        for user, level in grants.items():
            self.grants[int(user.removeprefix("u")), robot_id] = level
        return robot

    def add_credential(self, kind: CredentialKind, user: RelayUser) -> str:
        text = secrets.token_urlsafe()
        self.credentials[credential_of(kind, text)] = user
        return text

    def bearer(self, user: RelayUser) -> dict[str, str]:
        return {"Authorization": f"Bearer {self.add_credential('token', user)}"}

    def sessions(self) -> list[SessionEntry]:
        return [entry for entry in self.written if isinstance(entry, SessionEntry)]

    async def changes(self) -> Changes:
        self._check_up()
        credentials = repr(sorted(map(repr, self.credentials)))
        return Changes(self._rights(), credentials, tuple(self.routes))

    async def load(self) -> Snapshot:
        self._check_up()
        return Snapshot(dict(self.robots), dict(self.grants), self._rights())

    async def help_requests(self) -> list[RelayRequest]:
        self._check_up()
        return self.requests

    async def count_connections(self) -> None:
        pass

    async def last_seen(self) -> list[tuple[int, datetime, str | None]]:
        self._check_up()
        return self.seen

    async def users_of(
        self, credentials: Collection[Credential], *, briefly: bool = False
    ) -> dict[Credential, RelayUser]:
        self._check_up()
        self.lookups += 1
        return {key: self.credentials[key] for key in credentials if key in self.credentials}

    async def stored_control(self, robot_id: int | None = None) -> StoredControl:
        self._check_up()
        fences = {each: fence for each, fence in self.fences.items() if robot_id in {None, each}}
        return StoredControl(fences, [s for s in self.stops if robot_id in {None, s.robot_id}])

    async def next_fence(self, lease: NewLease) -> int:
        self._check_up()
        fence = max(self.fences.get(lease.robot_id, 0), lease.above) + 1
        self.fences[lease.robot_id] = fence
        return fence

    async def heartbeat(
        self, cell: CellSettings, counts: CellCounts, started_at: datetime
    ) -> list[Cell]:
        self._check_up()
        before = self.cells.get(cell.name)
        self.cells[cell.name] = Cell(
            name=cell.name,
            host=cell.host,
            https_port=cell.https_port,
            ssh_ports=cell.ssh_ports,
            peer_address=cell.peer_address,
            version=__version__,
            robots=counts.robots,
            draining=before is not None and before.draining,
            is_alive=True,
            region=cell.region,
            disk_free=counts.disk_free,
            recorders=counts.recorders,
        )
        return list(self.cells.values())

    async def write(self, entries: Sequence[Entry]) -> dict[int, int]:
        self._check_up()
        self.written.extend(entry for entry in entries if entry not in self.written)
        ended = {entry.route_id for entry in entries if isinstance(entry, RouteEnd)}
        self.routes = [route for route in self.routes if route.id not in ended]
        return {position: position + 1 for position, _ in enumerate(entries)}

    async def sign_newest(self, chain: str, sign: object) -> None:
        pass

    async def chains_to_sign(self) -> list[str]:
        return []

    def close(self) -> None:
        pass

    def _check_up(self) -> None:
        if self.down:
            raise StoreUnavailableError("cannot reach the database: the test took them away")

    def _rights(self) -> str:
        return repr((self.robots, self.grants))


class RelayServer:
    def __init__(self, relay: Relay, memory_database: RelayDatabase) -> None:
        self.relay = relay
        self.signer = TicketSigner(TICKET_KEY, 30)
        self._memory_database = memory_database

    @property
    def url(self) -> str:
        return f"http://{HOST}:{self.relay.http_port}"

    @property
    def inside_url(self) -> str:
        return f"http://{HOST}:{self.relay.inside_port}"

    def ticket(
        self,
        robot: RelayRobot,
        mode: Mode = "drive",
        user: RelayUser | None = None,
        credential: Credential | None = None,
    ) -> str:
        """Sign a ticket as web does, for a login of the user unless the test names a credential."""
        user = user or RelayUser(1, "ann")
        by = credential or self._login_of(user)
        fields = (user.id, user.name, robot.id, robot.name, mode, by.kind, by.digest.hex())
        return self.signer.sign(Ticket(secrets.token_hex(16), *fields))

    def ros_url(
        self,
        robot: RelayRobot,
        mode: Mode = "drive",
        user: RelayUser | None = None,
        credential: Credential | None = None,
    ) -> str:
        ticket = self.ticket(robot, mode, user, credential)
        return f"{self.url}/robots/{robot.name}/ros?ticket={ticket}"

    def app_url(self, name: str, user: RelayUser, ticket_of: str | None = None) -> str:
        """Where a user's app connects; the ticket is for the app of that name unless the test names another."""
        by = self._login_of(user)
        who, what, credential = (user.id, user.name), ticket_of or name, (by.kind, by.digest.hex())
        ticket = self.signer.sign(
            Ticket(secrets.token_hex(16), *who, None, what, "app", *credential)
        )
        return f"{self.url}/apps/{name}/ros?ticket={ticket}"

    def _login_of(self, user: RelayUser) -> Credential:
        login = credential_of("login", f"the login of {user.name}")
        if isinstance(self._memory_database, MemoryDatabase):
            self._memory_database.credentials.setdefault(login, user)
        return login


def cell_settings(
    name: str = "main",
    host: str | None = None,
    peer_address: str | None = None,
    region: str | None = None,
) -> CellSettings:
    """A cell, which robots are not sent to unless it has a host."""
    return CellSettings(name, host, 443, (2222, 443), peer_address, region)


def relay_settings(cell: CellSettings | None = None) -> RelaySettings:
    return RelaySettings(
        database=DatabaseSettings("nowhere", 1, "none", "none", "none"),
        cell=cell or cell_settings(),
        tickets=TicketSettings(TICKET_KEY, 30),
        session_key=SESSION_KEY,
        tunnel_host=HOST,
        allowed_origins=("https://lab.example",),
        message_limit_bytes=MESSAGE_LIMIT,
        log_level="info",
    )


@asynccontextmanager
async def running_relay(
    memory_database: RelayDatabase,
    timing: Timing = FAST,
    cell: CellSettings | None = None,
    peer_keys: PeerKeys | None = None,
    journal: Journal | None = None,
) -> AsyncIterator[RelayServer]:
    listen = Listen(host=HOST, http_port=0, session_port=0, peer_port=0, inside_port=0)
    settings = relay_settings(cell=cell)
    relay = Relay(
        settings,
        memory_database,
        listen=listen,
        timing=timing,
        peer_keys=peer_keys,
        journal=journal,
    )
    await relay.start()
    try:
        yield RelayServer(relay, memory_database)
    finally:
        await relay.stop()


async def until(condition: Callable[[], object], what: str, within_s: float = WAIT_S) -> None:
    deadline = asyncio.get_running_loop().time() + within_s
    while not condition():
        assert asyncio.get_running_loop().time() < deadline, f"not in {within_s:g} s: {what}"
        await asyncio.sleep(0.01)


def run_python(*arguments: str) -> CompletedProcess[str]:
    environment = {"PATH": os.environ["PATH"], "PYTHONPATH": os.pathsep.join(sys.path)}
    return run_command(sys.executable, *arguments, env=environment)


def utc(*parts: int) -> datetime:
    return datetime(*parts, tzinfo=timezone.utc)  # type: ignore[misc,arg-type]  # date and time

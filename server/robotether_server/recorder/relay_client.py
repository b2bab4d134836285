"""The recorder's connections to the relay of its stack: the channel of its own, rosbridge, and frames of cameras.

Each is opened with a ticket of the recorder's own, which the relay takes for observing alone.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Mapping
from typing import Any
from urllib.parse import quote

import msgspec
from aiohttp import ClientError, ClientSession, ClientWebSocketResponse, WSMsgType
from msgspec import Struct
from robotether_common.frames import HEADER, MAX_FRAME_BYTES

from robotether_server.contract.recordings import NS_PER_S
from robotether_server.db.fleet import RECORDER
from robotether_server.db.recordings import RecordableRobot
from robotether_server.problems import reason_in
from robotether_server.settings.server import RecorderSettings
from robotether_server.tickets import RECORDER_SALT, Ticket, TicketSigner, new_id

log = logging.getLogger(__name__)

PUBLIC_PORT, INSIDE_PORT = 8080, 9100
# Time between two attempts to reach the relay, or a robot.
AGAIN_S = 1.0
HEARTBEAT_S = 10.0
# Maximum time for which a relay that answers no ping counts as there; aiohttp waits half a heartbeat for the answer.
SILENT_S = 1.5 * HEARTBEAT_S
NO_ROBOT = RecordableRobot(0, "")


class RelayEvent(Struct):
    """What the relay sends; `lost` is the number of events that the recorder was too slow for."""

    robot_id: int = 0
    topic: str = ""
    message: dict[str, Any] = {}
    lost: int = 0


class RelayClient:
    """Opens connections to the relay."""

    def __init__(self, settings: RecorderSettings, session: ClientSession) -> None:
        self._host = (
            f"[{settings.relay_host}]" if ":" in settings.relay_host else settings.relay_host
        )
        self._signer = TicketSigner(settings.tickets.key, settings.tickets.ttl_s, RECORDER_SALT)
        self._limit = settings.message_limit_bytes
        self._session = session

    async def open_channel(self) -> ClientWebSocketResponse:
        """Open the channel of the recorder's own."""
        url = f"http://{self._host}:{INSIDE_PORT}/recorder?ticket={self._ticket(NO_ROBOT)}"
        return await self._session.ws_connect(url, heartbeat=HEARTBEAT_S)

    async def open_rosbridge(self, robot: RecordableRobot) -> ClientWebSocketResponse:
        """Open a robot's rosbridge, to observe."""
        url = f"http://{self._host}:{PUBLIC_PORT}/robots/{robot.name}/ros?ticket={self._ticket(robot)}"
        return await self._session.ws_connect(url, max_msg_size=self._limit + 1)

    async def open_frames(self, robot: RecordableRobot, camera: str) -> ClientWebSocketResponse:
        """Open the frames of a robot's camera."""
        query = f"topic={quote(camera, safe='')}&ticket={self._ticket(robot)}"
        url = f"http://{self._host}:{PUBLIC_PORT}/robots/{robot.name}/video/frames?{query}"
        return await self._session.ws_connect(url, max_msg_size=HEADER.size + MAX_FRAME_BYTES + 1)

    def _ticket(self, robot: RecordableRobot) -> str:
        # It names no login: the recorder has none.
        ticket = Ticket(
            new_id(), RECORDER.id, RECORDER.name, robot.id, robot.name, "observe", "token", "0" * 64
        )
        return self._signer.sign(ticket)


class RelayChannel:
    """The channel that tells what the relay knows of the robots that are followed; it is opened again when it ends.

    `on_lost` gets the time from which on events are lost, in ns of Unix.
    """

    def __init__(
        self,
        client: RelayClient,
        on_event: Callable[[int, str, Mapping[str, Any]], None],
        on_lost: Callable[[int], None],
    ) -> None:
        self._client = client
        self._on_event = on_event
        self._on_lost = on_lost
        # When the last event came, in ns of Unix.
        self._heard_ns = 0
        # By robot: whether it is written down.
        self._followed: dict[int, bool] = {}
        self._socket: ClientWebSocketResponse | None = None

    @property
    def is_open(self) -> bool:
        """Whether the relay can be reached."""
        return self._socket is not None

    async def follow(self, robot_id: int, *, writes: bool) -> None:
        """Be told of a robot, and tell the relay whether it is written down."""
        if self._followed.get(robot_id) is not writes:
            self._followed[robot_id] = writes
            await self._request(robot_id, follows=True, writes=writes)

    async def leave(self, robot_id: int) -> None:
        """Be told of a robot no longer."""
        if self._followed.pop(robot_id, None) is not None:
            await self._request(robot_id, follows=False, writes=False)

    async def run(self) -> None:
        """Read the channel, for ever."""
        while True:
            try:
                async with await self._client.open_channel() as socket:
                    self._socket = socket
                    log.info("connected to the relay")
                    # Others may come and go meanwhile.
                    for robot_id, writes in list(self._followed.items()):
                        await self._request(robot_id, follows=True, writes=writes)
                    await self._read(socket)
            except (ClientError, OSError) as exc:
                log.info("cannot reach the relay: %s", reason_in(exc))
            finally:
                if self._socket is not None:
                    self._socket = None
                    self._note_lost()
            await asyncio.sleep(AGAIN_S)

    def _note_lost(self) -> None:
        # An answer to a ping is no event, so one that said nothing was heard when the last ping was answered.
        self._on_lost(max(self._heard_ns, time.time_ns() - int(SILENT_S * NS_PER_S)))

    async def _read(self, socket: ClientWebSocketResponse) -> None:
        async for message in socket:
            if message.type is not WSMsgType.TEXT:
                return
            event = msgspec.json.decode(message.data, type=RelayEvent)
            if event.lost:
                log.warning("%d events of the relay came too fast and are lost", event.lost)
                self._note_lost()
            else:
                self._on_event(event.robot_id, event.topic, event.message)
            self._heard_ns = time.time_ns()

    async def _request(self, robot_id: int, *, follows: bool, writes: bool) -> None:
        socket = self._socket
        if socket is None:
            # It is told when the channel is open.
            return
        try:
            await socket.send_json({"robot_id": robot_id, "follows": follows, "writes": writes})
        except (ClientError, ConnectionError):
            log.info("the relay is gone")

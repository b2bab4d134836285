"""One receiver of a camera's pictures: what it wants, its credit, and the newest picture that it has not got yet.

Run by the frames service for each WebSocket. A picture goes out for a credit only, and then the newest; whoever takes
nothing for IDLE_S has no source open. Holds one picture and a few texts.
"""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from aiohttp import WSMsgType, web

from robotether_agent.clock import robot_time
from robotether_agent.media.feeds import Feeds
from robotether_agent.media.header import NUMBERS, Header
from robotether_agent.media.picture import Picture, Wish, jpeg_size
from robotether_agent.media.quality import Steps, ladder
from robotether_agent.media.rates import Gate, Meter
from robotether_agent.media.switch import Switch
from robotether_agent.media.want import CREDITS_MAX, Beat, Credit, Want, parse
from robotether_agent.tasks import first_of

IDLE_S = 2.0
LOOK_EVERY_S = 0.25
STATUS_EVERY_S = 1.0
TEXTS_MAX = 8
# Pictures that went out and are not told of yet; more than a receiver that keeps the rules ever has.
UNDER_WAY_MAX = 8
SIZE_MIN = 16

JsonFields = dict[str, object]


@dataclass(frozen=True)
class Sent:
    """A picture that is under way."""

    number: int
    arrived_s: float
    wish: Wish


class Receiver:
    """One end of the frames protocol; make it, then await run()."""

    def __init__(
        self,
        socket: web.WebSocketResponse,
        topic: str,
        feeds: Feeds,
        *,
        steps_quality: bool,
        clock: Callable[[], float] = robot_time,
    ) -> None:
        self._socket = socket
        self._topic = topic
        self._clock = clock
        self._steps_quality = steps_quality
        self._can_scale = True
        self._own_size: tuple[int, int] | None = None
        self._switch = Switch(feeds, self._came, clock)
        self._want: Want | None = None
        self._steps: Steps | None = None
        self._gate = Gate(Want.fps)
        self._credit = 0
        self._credit_s = clock()
        self._number = 0
        self._newest: tuple[int, Picture, Wish] | None = None
        self._under_way: deque[Sent] = deque(maxlen=UNDER_WAY_MAX)
        self._texts: deque[JsonFields] = deque(maxlen=TEXTS_MAX)
        self._status: JsonFields = {}
        self._status_s = self._looked_s = clock() - STATUS_EVERY_S
        self._offered, self._sent = Meter(), Meter()
        self._wake = asyncio.Event()

    async def run(self) -> None:
        """Serve until the receiver leaves; FieldError for a text that breaks the protocol."""
        try:
            await first_of(self._listen(), self._send(), self._keep_looking())
        finally:
            self._switch.leave()

    async def _listen(self) -> None:
        async for message in self._socket:
            if message.type is WSMsgType.TEXT:
                self._asked(message.data)

    def _asked(self, text: str) -> None:
        request = parse(text)
        if isinstance(request, Beat):
            # Read now: it may wait behind a picture, which does not make the clock another one.
            self._say({"op": "beat", "t_ms": request.t_ms, "sender_ms": self._clock() * 1000})
        elif isinstance(request, Credit):
            self._credited(request)
        elif isinstance(request, Want):
            self._wants(request)

    def _wants(self, want: Want) -> None:
        if self._want is None or self._want.fps != want.fps:
            self._gate = Gate(want.fps)
        self._want = want
        self._credit_s = self._clock()
        self._use_levels(want)
        self._follow()
        self._look()

    def _use_levels(self, want: Want) -> None:
        """Make quality and size steps of what is wanted, and of what is known of the camera."""
        has_size = self._own_size is not None or want.width is not None
        levels = ladder(want.quality_min, want.quality_max, scales=self._can_scale and has_size)
        now_s, latency_s = self._clock(), want.latency_ms / 1000
        if self._steps is None:
            self._steps = Steps(levels, latency_s, now_s)
        else:
            self._steps.use(levels, latency_s, now_s)

    def _credited(self, credit: Credit) -> None:
        now_s = self._clock()
        self._credit = min(CREDITS_MAX, self._credit + credit.frames)
        self._credit_s = now_s
        if credit.taken is not None:
            self._was_taken(credit.taken, now_s)
        if self._switch.wish is None:
            self._follow()
        self._wake.set()

    def _was_taken(self, number: int, now_s: float) -> None:
        if all(sent.number != number for sent in self._under_way):
            return
        sent = self._under_way.popleft()
        while sent.number != number:
            sent = self._under_way.popleft()
        if self._steps is None or sent.wish != self._switch.wish or not self._can_step():
            return
        if self._steps.taken(now_s, now_s - sent.arrived_s):
            self._follow()

    def _can_step(self) -> bool:
        """Whether the source gives the quality that it is asked for."""
        return self._steps_quality and self._switch.condition().source == "web_video_server"

    def _follow(self) -> None:
        if self._want is not None and self._steps is not None:
            self._switch.follow(self._wish(self._want, self._steps))

    def _wish(self, want: Want, steps: Steps) -> Wish:
        if not self._steps_quality:
            return Wish(self._topic, 0, None, None, want.fps)
        level = steps.level
        width, height = want.width, want.height
        if level.scale < 1:
            whole = self._own_size
            if want.width is not None and want.height is not None:
                whole = want.width, want.height
            if whole is not None:
                width, height = (max(SIZE_MIN, int(side * level.scale) // 2 * 2) for side in whole)
        return Wish(self._topic, level.quality, width, height, want.fps)

    def _came(self, picture: Picture, wish: Wish) -> None:
        now_s = self._clock()
        self._number = (self._number + 1) % NUMBERS
        if self._own_size is None and wish.width is None:
            self._learn_size(picture)
        if not self._gate.passes(now_s):
            return
        self._offered.note(now_s)
        self._newest = self._number, picture, wish
        self._wake.set()

    def _learn_size(self, picture: Picture) -> None:
        self._own_size = jpeg_size(picture.jpeg)
        if self._own_size is not None and self._want is not None:
            self._use_levels(self._want)

    async def _send(self) -> None:
        while True:
            await self._wake.wait()
            self._wake.clear()
            while self._texts:
                await self._socket.send_str(json.dumps(self._texts.popleft()))
            if self._credit and self._newest is not None:
                await self._send_picture(*self._newest)
                self._wake.set()

    async def _send_picture(self, number: int, picture: Picture, wish: Wish) -> None:
        self._newest = None
        self._credit -= 1
        self._under_way.append(Sent(number, picture.arrived_s, wish))
        self._sent.note(self._clock())
        quality = wish.quality if self._can_step() else 0
        header = Header(number, picture.moment_s * 1000, quality, picture.is_stamped)
        await self._socket.send_bytes(header.packed() + picture.jpeg)

    def _say(self, text: JsonFields) -> None:
        self._texts.append(text)
        self._wake.set()

    async def _keep_looking(self) -> None:
        while True:
            await asyncio.sleep(LOOK_EVERY_S)
            self._look()

    def _look(self) -> None:
        """Do what no message brings: let go of a source that nobody takes from, judge rates, tell the status."""
        if self._want is None:
            return
        now_s = self._clock()
        if self._credit == 0 and now_s - self._credit_s > IDLE_S:
            self._switch.leave()
            self._newest = None
            return
        if self._switch.give_up_late() and self._can_scale:
            # It may be that it knows no sizes.
            self._can_scale = False
            self._use_levels(self._want)
            self._follow()
        if now_s - self._looked_s >= 1:
            self._looked_s = now_s
            self._judge_rates(now_s)
        if now_s - self._status_s >= STATUS_EVERY_S:
            self._tell_status(now_s)

    def _judge_rates(self, now_s: float) -> None:
        if self._steps is None or not self._can_step():
            return
        if self._steps.looked(now_s, self._offered.rate(now_s), self._sent.rate(now_s)):
            self._follow()

    def _tell_status(self, now_s: float) -> None:
        found = self._switch.condition()
        wish = self._switch.wish if self._can_step() else None
        status: JsonFields = {
            "op": "status",
            "state": found.state,
            "detail": found.detail,
            "source": found.source,
            "quality": 0 if wish is None else wish.quality,
            "width": None if wish is None else wish.width,
            "height": None if wish is None else wish.height,
            "fps": round(self._sent.rate(now_s), 1),
        }
        if status != self._status:
            self._status, self._status_s = status, now_s
            self._say(status)

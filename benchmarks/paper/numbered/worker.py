"""A process that sends or receives numbered messages on many connections: the load generator of high_rate.

Started by run.py, which speaks with it in JSON lines: a namespace and its ends on stdin, "ready" back when all are
connected; senders then wait for {"begin_ns"}, receivers for {"sent"} after which ten seconds of silence end them;
the last line back is what each end saw, with this process's own CPU time. A connection that fails before the start is
dialled again and counted; one that ends later ends the run.
"""

from __future__ import annotations

import asyncio
import json
import selectors
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass
from typing import Any

import aiohttp
from namespaces import Namespace

from paper.client import FAILURES, Client, new_http
from paper.networks import made_in
from paper.numbered.messages import NS_A_MS, TOPIC, TYPE, Account, Histogram, publish
from paper.programs import write_line

SILENCE_S = 10.0
DIAL_WITHIN_S, AGAIN_S = 30.0, 0.2
NS_A_S = 1_000_000_000
READY = {"op": "call_service", "id": "ready", "service": "/rosapi/topics"}


@dataclass(frozen=True, kw_only=True)
class End:
    """One end of a pair, as JSON carries it: a rosbridge connection on which it sends or receives."""

    pair: int
    count: int
    rate_hz: float
    sends: bool
    # Of the robot's own rosbridge; an operator has HOST:PORT of the site in its place.
    url: str = ""
    site: str = ""
    token: str = ""
    robot: str = ""


class Connection:
    """A rosbridge connection of an end."""

    def __init__(
        self, end: End, http: aiohttp.ClientSession, on_message: Callable[[str], None]
    ) -> None:
        self._end = end
        self._http = http
        self._on_message = on_message
        self._socket: aiohttp.ClientWebSocketResponse
        self._reading: asyncio.Task[None]
        # Why there was none at first, and how often.
        self.failures: Counter[str] = Counter()

    async def dial(self) -> None:
        """Connect, again and again for some time; ConnectionError with the pair when that fails."""
        until_s = time.monotonic() + DIAL_WITHIN_S
        while True:
            try:
                return await self._dial()
            except FAILURES as error:
                self.failures[str(error)] += 1
                if time.monotonic() > until_s:
                    raise ConnectionError(f"pair {self._end.pair}: {error}") from error
            await asyncio.sleep(AGAIN_S)

    async def _dial(self) -> None:
        """Connect, and wait until the robot's rosbridge has taken what this end is for."""
        self._socket = await self._connected()
        await self._socket.send_json(
            {"op": "advertise" if self._end.sends else "subscribe", "topic": TOPIC, "type": TYPE}
        )
        # Operations are taken in order, so the answer to this one tells that the one before is in force.
        await self._socket.send_json(READY)
        ready = asyncio.Event()
        self._reading = asyncio.create_task(self._read(ready))
        waiting = asyncio.ensure_future(ready.wait())
        await asyncio.wait(
            (waiting, self._reading), timeout=DIAL_WITHIN_S, return_when=asyncio.FIRST_COMPLETED
        )
        waiting.cancel()
        if not ready.is_set():
            await self.close()
            raise ConnectionError(f"no answer of rosbridge; close code {self._socket.close_code}")

    async def send(self, text: str) -> None:
        """Hand one message to the connection; ConnectionError if it has ended."""
        self.check()
        await self._socket.send_str(text)

    def check(self) -> None:
        """Raise ConnectionError with the close code if it has ended."""
        if self._reading.done():
            why = f"close code {self._socket.close_code}"
            raise ConnectionError(f"the connection of pair {self._end.pair} ended: {why}")

    async def close(self) -> None:
        self._reading.cancel()
        await asyncio.gather(self._reading, return_exceptions=True)
        with suppress(TimeoutError):
            await asyncio.wait_for(self._socket.close(), 2)

    def as_json(self) -> dict[str, Any]:
        """How often there was no connection at first, and why."""
        return {"failed_dials": self.failures.total(), "dial_failures": list(self.failures)}

    async def _connected(self) -> aiohttp.ClientWebSocketResponse:
        end = self._end
        if end.site:
            client = Client(self._http, end.site, end.token, DIAL_WITHIN_S)
            return await client.connect(end.robot, "drive" if end.sends else "observe")
        async with asyncio.timeout(DIAL_WITHIN_S):
            return await self._http.ws_connect(end.url, compress=0, max_msg_size=0)

    async def _read(self, ready: asyncio.Event) -> None:
        """Hear what comes; reading also answers pings."""
        async for message in self._socket:
            if message.type is not aiohttp.WSMsgType.TEXT:
                continue
            said = json.loads(message.data)
            if said.get("op") == "publish" and said.get("topic") == TOPIC:
                self._on_message(said["msg"]["data"])
            elif said.get("op") == "service_response":
                ready.set()


class Sender:
    """Publishes each message when it is due, or as soon after as the connection takes it."""

    def __init__(self, end: End, http: aiohttp.ClientSession) -> None:
        self._end = end
        self.connection = Connection(end, http, lambda _: None)
        self._lateness = Histogram()

    async def run(self, begin_ns: int) -> None:
        """Send them all, from `begin_ns` on."""
        for number in range(self._end.count):
            due_ns = begin_ns + int(number * NS_A_S / self._end.rate_hz)
            await _sleep_until(due_ns)
            now_ns = time.monotonic_ns()
            await self.connection.send(publish(self._end.pair, number, due_ns))
            self._lateness.add((now_ns - due_ns) / NS_A_MS)
        self.connection.check()

    def result(self) -> dict[str, Any]:
        return {
            "pair": self._end.pair,
            "sent": self._lateness.total,
            **self.connection.as_json(),
            "lateness": self._lateness.as_json(),
        }


class Receiver:
    """Counts what comes."""

    def __init__(self, end: End, http: aiohttp.ClientSession) -> None:
        self.connection = Connection(end, http, self._note)
        self.account = Account(end.pair, end.count)
        self.received_ns = 0

    def _note(self, data: str) -> None:
        self.received_ns = time.monotonic_ns()
        self.account.note(data, self.received_ns)

    def result(self) -> dict[str, Any]:
        return {**self.account.as_json(), **self.connection.as_json()}


async def _sleep_until(due_ns: int) -> None:
    left_ns = due_ns - time.monotonic_ns()
    if left_ns > 0:
        await asyncio.sleep(left_ns / NS_A_S)


async def _wait_for_last(receivers: Sequence[Receiver], sent: asyncio.Future[Any]) -> None:
    """Wait until each message has come, or after all were sent for SILENCE_S without any."""
    since_ns = 0
    while not all(receiver.account.complete for receiver in receivers):
        await asyncio.sleep(0.05)
        for receiver in receivers:
            receiver.connection.check()
        if not sent.done():
            continue
        since_ns = since_ns or time.monotonic_ns()
        last_ns = max(since_ns, *(receiver.received_ns for receiver in receivers))
        if time.monotonic_ns() - last_ns > SILENCE_S * NS_A_S:
            return


async def _read_order() -> Mapping[str, Any]:
    line = await asyncio.to_thread(sys.stdin.readline)
    if not line:
        raise EOFError("whoever started this load generator is gone")
    answer: Mapping[str, Any] = json.loads(line)
    return answer


async def work() -> None:
    order = await _read_order()
    ends = [End(**values) for values in order["ends"]]
    async with AsyncExitStack() as stack:
        inside = made_in(Namespace(order["namespace"], ""))
        http = await stack.enter_async_context(new_http(**inside))
        kind = Sender if ends[0].sends else Receiver
        made = [kind(end, http) for end in ends]
        await asyncio.gather(*(item.connection.dial() for item in made))
        for item in made:
            stack.push_async_callback(item.connection.close)
        write_line({"ready": True})
        started, cpu_s = time.monotonic(), time.process_time()
        if ends[0].sends:
            await _send_all(made, ends[0].rate_hz)
        else:
            await _wait_for_last(made, asyncio.ensure_future(_read_order()))
        values = [item.result() for item in made]
        write_line(
            {
                "ends": values,
                "cpu_s": time.process_time() - cpu_s,
                "took_s": time.monotonic() - started,
            }
        )


async def _send_all(senders: Sequence[Sender], rate_hz: float) -> None:
    """Send all, and stay connected until the receivers have seen what they will: an end could cut off what waits."""
    begin_ns = (await _read_order())["begin_ns"]
    # Pairs are not in step, as operators are not.
    offset_ns = NS_A_S / rate_hz / len(senders)
    begins = [begin_ns + int(position * offset_ns) for position in range(len(senders))]
    await asyncio.gather(*(sender.run(at) for sender, at in zip(senders, begins, strict=True)))
    write_line({"sent": True, "sending_s": (time.monotonic_ns() - begin_ns) / NS_A_S})
    await _read_order()


if __name__ == "__main__":
    # epoll's pauses are whole ms, so that each message would be up to one late; select's are finer.
    with asyncio.Runner(
        loop_factory=lambda: asyncio.SelectorEventLoop(selectors.SelectSelector())
    ) as runner:
        runner.run(work())

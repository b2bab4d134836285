"""What of a robot's topics is recorded."""

import asyncio
import json
import math
import struct

import pytest
from aiohttp import WSMessage, WSMsgType
from robotether_server.recorder.observer import RosbridgeObserver

SPEED = {
    "type": "demo/Speed",
    "fieldnames": ["value"],
    "fieldtypes": ["float32"],
    "fieldarraylen": [-1],
}


class RosbridgeSocket:
    """A robot with these topics, each of which has one message, as text in place of JSON."""

    def __init__(self, topics, message):
        self._topics, self._message = topics, message
        self._texts = asyncio.Queue()

    async def send_str(self, text):
        message = json.loads(text)
        if message["op"] == "subscribe":
            await self._put(
                f'{{"op": "publish", "topic": "{message["topic"]}", "msg": {self._message}}}'
            )
            return
        values = {
            "topics": list(self._topics),
            "types": list(self._topics.values()),
            "typedefs": [SPEED],
        }
        answer = {"op": "service_response", "id": message["id"], "values": values, "result": True}
        await self._put(json.dumps(answer))

    async def _put(self, text):
        await self._texts.put(WSMessage(WSMsgType.TEXT, text, None))

    def __aiter__(self):
        return self

    async def __anext__(self):
        return await self._texts.get()


async def recorded(socket, count):
    """Return the messages that are recorded, until there are so many."""
    messages = asyncio.Queue()
    observer = RosbridgeObserver(socket, messages.put_nowait, lambda _cameras: None)
    observing = asyncio.create_task(observer.run())
    try:
        async with asyncio.timeout(5):
            return [await messages.get() for _ in range(count)]
    finally:
        observing.cancel()
        await asyncio.gather(observing, return_exceptions=True)


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "null"])
async def test_a_number_that_json_lacks_leaves_the_rest_of_its_message(number):
    socket = RosbridgeSocket({"/speed": "demo/Speed"}, f'{{"value": {number}, "name": "NaN"}}')
    [message] = await recorded(socket, 1)
    [value] = struct.unpack_from("<f", message.data, 4)
    assert math.isnan(value)

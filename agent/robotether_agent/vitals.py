"""Reads the robot's battery through rosbridge, and reports changes to the server.

A task of the session, so that nobody asks the robot while nobody is told. It holds one
subscription, of one message in 5 s at most, and none on a robot without a battery's topic. Never tells what is old:
a battery that was not heard for SILENT_S is unknown.
"""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict

import aiohttp
from robotether_common.session import Battery

from robotether_agent.fields import JsonObject
from robotether_agent.rosbridge import Rosbridge, connected
from robotether_agent.tasks import first_of, within

BATTERY_TYPE = "sensor_msgs/BatteryState"
# Tried in this order; else the first by name.
USUAL_TOPICS = ("/battery_state", "/battery", "/battery_status")
EVERY_S = 5.0
SILENT_S = 60.0
RETRY_S = 30.0
MAX_MESSAGE_BYTES = 1024 * 1024
# sensor_msgs/BatteryState's POWER_SUPPLY_STATUS_CHARGING.
CHARGING = 1

Send = Callable[[Mapping[str, object]], None]

log = logging.getLogger(__name__)


class Vitals:
    """What is known of the robot's battery, and who is told."""

    def __init__(self, rosbridge_url: str, *, every_s: float = EVERY_S) -> None:
        self._rosbridge_url = rosbridge_url
        self._every_s = every_s
        self._battery: Battery | None = None
        self._changed = asyncio.Event()

    async def report(self, send: Send) -> None:
        """Tell of each change, the newest once in 5 s at most; runs until it is cancelled."""
        self._battery = None
        await first_of(self._keep_listening(), self._keep_reporting(send))

    async def _keep_reporting(self, send: Send) -> None:
        # A new session knows of none.
        reported: Battery | None = None
        while True:
            await self._changed.wait()
            self._changed.clear()
            if self._battery != reported:
                reported = self._battery
                send({"type": "vitals", "battery": None if reported is None else asdict(reported)})
                await asyncio.sleep(self._every_s)

    async def _keep_listening(self) -> None:
        while True:
            try:
                await self._listen()
            except (aiohttp.ClientError, OSError, asyncio.TimeoutError) as error:
                # rosbridge is down, or has no rosapi: health tells of the former.
                log.debug("no battery: %r", error)
            self._found(None)
            await asyncio.sleep(RETRY_S)

    async def _listen(self) -> None:
        """Follow the battery's topic until it falls silent; return at once when there is none."""
        url = self._rosbridge_url
        async with connected(url, max_message_bytes=MAX_MESSAGE_BYTES) as rosbridge:
            topic = battery_topic(await rosbridge.topics())
            if topic is not None:
                await self._follow(rosbridge, topic)

    async def _follow(self, rosbridge: Rosbridge, topic: str) -> None:
        throttle_ms = int(self._every_s * 1000)
        await rosbridge.subscribe(topic, BATTERY_TYPE, throttle_ms=throttle_ms)
        while True:
            self._found(battery_in(await within(SILENT_S, rosbridge.message())))

    def _found(self, battery: Battery | None) -> None:
        if battery != self._battery:
            self._battery = battery
            self._changed.set()


def battery_topic(topics: Mapping[str, str]) -> str | None:
    """Return the topic of the robot's battery, if it has one."""
    found = sorted(name for name, kind in topics.items() if kind == BATTERY_TYPE)
    usual = (name for name in USUAL_TOPICS if name in found)
    return next(usual, found[0] if found else None)


def battery_in(message: JsonObject) -> Battery | None:
    """Return what a BatteryState says, or nothing when it does not say how full it is.

    `percentage` is 0 to 1; some drivers write 0 to 100. What cannot be measured is NaN, which rosbridge writes null.
    """
    part = _number(message, "percentage")
    if part is None:
        charge, capacity = _number(message, "charge"), _number(message, "capacity")
        part = charge / capacity if charge is not None and capacity else None
    if part is None or not 0 <= part <= 100:  # noqa: PLR2004
        return None
    percent = round(part * 100 if part <= 1 else part)
    return Battery(percent, message.get("power_supply_status") == CHARGING)


def _number(message: JsonObject, name: str) -> float | None:
    value = message.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    # A whole number may be larger than any float, and must not end the session that tells of it.
    with suppress(OverflowError):
        return float(value) if math.isfinite(value) else None
    return None

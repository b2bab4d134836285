"""Reads how full the robot's battery is, and reports changes.

`Vitals` is a task of the session, so that nobody asks the robot while there is no session. It holds one subscription,
of one message in 5 s at most, and none on a robot without a battery's topic. What it reports is what every page shows:
the unit of a driver's `percentage` is decided here alone.
"""

from __future__ import annotations

import asyncio
import json
import logging
import math
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

import aiohttp
from robotether_common.own_topics import own_topic
from robotether_common.session import Battery

from robotether_agent.fields import (
    FieldError,
    JsonObject,
    get_text,
    number_in,
    parse_object,
)
from robotether_agent.files import read_text, write_atomic
from robotether_agent.problems import StateUnusableError
from robotether_agent.rosbridge import RosGraph, connected
from robotether_agent.tasks import first_of, within

# Maximum size of a BatteryState, which lists voltage and temperature of each cell.
MAX_MESSAGE_BYTES = 1024 * 1024
BATTERY_TYPE = "sensor_msgs/BatteryState"
# In the robot's namespace, the best first.
USUAL_TOPICS = ("battery_state", "battery", "battery_status")
BATTERY_EVERY_S = 5.0
SILENT_S = 60.0
RETRY_S = 30.0
# sensor_msgs/BatteryState's POWER_SUPPLY_STATUS_CHARGING and POWER_SUPPLY_STATUS_FULL.
CHARGING, FULL = 1, 4
MEMORY_FILE = "battery.json"

# What a driver's `percentage` of 1 means: all (as the message defines it), or a hundredth.
Unit = Literal["fraction", "percent"]
# Maximum level read as a fraction, which may slightly exceed 1; a higher level is a percentage.
MAX_FRACTION = 1.2
# Minimum fraction of a full battery; as a percentage the same level would be almost empty.
NEARLY_ONE = 0.99
# Time after which a level that changed by less than STEADY_CHANGE is a fraction: an almost empty
# battery without a charger would be flat by then.
STEADY_S = 900.0
STEADY_CHANGE = 0.15
# Maximum level in percent before one of 1 or less that is percent still: no battery falls by more at once.
NEARLY_EMPTY = 10
# Number of successive messages over MAX_FRACTION that show percent: drivers write such numbers for unknown, too.
PERCENT_MESSAGES = 3
# Maximum difference between a charge in Ah and a percentage that agree.
SAME_LEVEL = 0.1
# Voltages, empty and full, of a cell of lithium ion, a cell of LFP, and a block of lead of 6 V.
CELLS = (
    ((2.9, 3.4), (4.0, 4.25)),
    ((2.8, 3.1), (3.3, 3.65)),
    ((5.25, 5.95), (6.25, 7.2)),
)

Send = Callable[[Mapping[str, object]], None]

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class BatterySettings:
    """What the server's settings say of the battery, and the robot's drive topic."""

    topic: str | None = None
    unit: Unit | None = None
    drive_topic: str = ""


class UnitMemory:
    """The unit that a topic has shown since the robot was enrolled, in a file that outlasts restarts."""

    def __init__(self, state_dir: Path) -> None:
        self._path = state_dir / MEMORY_FILE
        self._units: dict[str, Unit] = {}

    def of(self, topic: str) -> Unit | None:
        """Return the unit that this topic has shown, if it has."""
        if topic not in self._units:
            unit = self._read(topic)
            return unit and self._units.setdefault(topic, unit)
        return self._units[topic]

    def keep(self, topic: str, unit: Unit) -> None:
        """Remember what the topic has shown last."""
        if self.of(topic) == unit:
            return
        self._units[topic] = unit
        try:
            text = json.dumps({"topic": topic, "unit": unit}) + "\n"
            # Not synced: the guard stops a robot whose agent waits for a slow disk.
            write_atomic(self._path, text, 0o600, lasts=False)
        except StateUnusableError as error:
            log.warning("cannot keep how the battery counts: %s", error)

    def _read(self, topic: str) -> Unit | None:
        try:
            text = read_text(self._path)
            memory = None if text is None else parse_object(text, MEMORY_FILE)
            if memory is None or get_text(memory, "topic") != topic:
                return None
            unit = get_text(memory, "unit")
        except (StateUnusableError, FieldError) as error:
            log.warning("cannot read how the battery counts: %s", error)
            return None
        return unit if unit in {"fraction", "percent"} else None  # type: ignore[return-value]


class LevelTrend:
    """Knows the unit by several messages: percent, or a fraction by its slow change where nothing else shows it."""

    def __init__(self) -> None:
        self._percents = 0
        self._was_nearly_empty = False
        # None: nothing counts yet.
        self._since_s: float | None = None
        self._lowest = self._highest = 0.0

    def unit_shown(
        self, message: JsonObject, now_s: float, before: Unit | None = None
    ) -> Unit | None:
        """Return the unit that the levels up to this one show beyond doubt; `before` is what the topic has shown."""
        unit, steady_unit = unit_shown(message), self._steady_unit(message, now_s)
        level = number_in(message, "percentage")
        self._percents = self._percents + 1 if unit == "percent" else 0
        if level is not None and level > MAX_FRACTION:
            self._was_nearly_empty = level <= NEARLY_EMPTY
        return None if 0 < self._percents < PERCENT_MESSAGES else unit or before or steady_unit

    def is_doubtful(self, message: JsonObject) -> bool:
        """Whether a topic that has shown percent may show a fraction now, as of another driver."""
        level = number_in(message, "percentage")
        if level is None or not 0 < level <= MAX_FRACTION or self._was_nearly_empty:
            return False
        return _fits_voltage(level, message) or not _fits_voltage(level / 100, message)

    def _steady_unit(self, message: JsonObject, now_s: float) -> Unit | None:
        level = number_in(message, "percentage")
        charges = message.get("power_supply_status") == CHARGING
        if level is None or not STEADY_CHANGE < level < NEARLY_ONE or charges:
            self._since_s = None
            return None
        self._lowest, self._highest = min(self._lowest, level), max(self._highest, level)
        if self._since_s is None or self._highest - self._lowest >= STEADY_CHANGE:
            self._since_s, self._lowest, self._highest = now_s, level, level
        return "fraction" if now_s - self._since_s >= STEADY_S else None


class Vitals:
    """What is known of the robot's battery: nothing, once it was silent for SILENT_S."""

    def __init__(
        self,
        graph: RosGraph,
        state_dir: Path,
        *,
        pause: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        self._graph = graph
        self._memory = UnitMemory(state_dir)
        self._pause = pause
        self._battery: Battery | None = None
        self._changed = asyncio.Event()

    @property
    def battery(self) -> Battery | None:
        """The battery as it was last reported; None: unknown, as while nothing reports it."""
        return self._battery

    async def report(self, send: Send, settings: Callable[[], BatterySettings]) -> None:
        """Report each change, the newest once in 5 s at most; runs until it is cancelled."""
        try:
            await first_of(self._keep_listening(settings), self._keep_reporting(send))
        finally:
            # What comes meanwhile is not read.
            self._battery = None

    async def _keep_reporting(self, send: Send) -> None:
        # A new session knows of none.
        reported: Battery | None = None
        while True:
            await self._changed.wait()
            self._changed.clear()
            if self._battery != reported:
                reported = self._battery
                send({"type": "vitals", "battery": None if reported is None else asdict(reported)})
                await self._pause(BATTERY_EVERY_S)

    async def _keep_listening(self, settings: Callable[[], BatterySettings]) -> None:
        while True:
            try:
                await self._listen(settings)
            except (aiohttp.ClientError, OSError, asyncio.TimeoutError) as error:
                # rosbridge is down, or has no rosapi: health reports the former.
                log.debug("no battery: %r", error)
            self._set(None)
            await self._pause(RETRY_S)

    async def _listen(self, settings: Callable[[], BatterySettings]) -> None:
        """Follow the battery's topic until it falls silent or is another one; return at once when there is none."""
        current = settings()
        if current.topic is not None:
            await self._follow(current.topic, current, settings)
            return
        choose = partial(battery_topic, drive_topic=current.drive_topic)
        topic = choose(await self._graph.topics())
        if topic is not None:
            await first_of(
                self._follow(topic, current, settings),
                self._graph.until_another(topic, choose),
            )

    async def _follow(
        self, topic: str, current: BatterySettings, settings: Callable[[], BatterySettings]
    ) -> None:
        async with connected(self._graph.url, max_message_bytes=MAX_MESSAGE_BYTES) as rosbridge:
            throttle_ms = int(BATTERY_EVERY_S * 1000)
            await rosbridge.subscribe(topic, BATTERY_TYPE, throttle_ms=throttle_ms)
            trend = LevelTrend()
            while settings() == current:
                message = await within(SILENT_S, rosbridge.message())
                self._read(message, topic, current.unit, trend)

    def _read(
        self, message: JsonObject, topic: str, setting: Unit | None, trend: LevelTrend
    ) -> None:
        now_s = asyncio.get_running_loop().time()
        detected_unit = trend.unit_shown(message, now_s, self._memory.of(topic))
        if detected_unit is not None:
            self._memory.keep(topic, detected_unit)
        unit = setting or self._memory.of(topic)
        battery = battery_in(message, unit)
        if battery and unit == "percent" and not setting and trend.is_doubtful(message):
            battery = replace(battery, percent=None)
        self._set(battery)

    def _set(self, battery: Battery | None) -> None:
        if battery != self._battery:
            self._battery = battery
            self._changed.set()


def battery_topic(topics: Mapping[str, str], drive_topic: str) -> str | None:
    """Return the topic of the robot's battery, if it has one and it is not in doubt which."""
    return own_topic(topics, BATTERY_TYPE, USUAL_TOPICS, drive_topic)


def battery_in(message: JsonObject, unit: Unit | None) -> Battery | None:
    """Return what a BatteryState says, with no level where that is unknown or in doubt; nothing for no battery.

    `unit` is that of the settings, or the one that the topic has shown.
    """
    if message.get("present") is False or not message:
        return None
    return Battery(_percent(message, unit), message.get("power_supply_status") == CHARGING)


def _percent(message: JsonObject, unit: Unit | None) -> int | None:
    level = number_in(message, "percentage")
    if level is None:
        level = _charged(message)
        # 0 is what a driver sends that does not measure the charge.
        unit = "fraction" if level else None
    if level is None or not 0 <= level <= 100:  # noqa: PLR2004
        return None
    if unit == "percent":
        return round(level)
    if unit is None and _is_doubtful(level, message):
        return None
    return round(min(level, 1) * 100) if level <= MAX_FRACTION else None


def _is_doubtful(level: float, message: JsonObject) -> bool:
    """Whether a level of which the unit is unknown may as well be percent: 1 is full, or nearly empty.

    0 of a topic that has never shown another level is what a driver sends that does not know it.
    """
    return level == 0 or level >= NEARLY_ONE or not _fits_voltage(level, message)


def unit_shown(message: JsonObject) -> Unit | None:
    """Return the unit of `percentage` that this message shows beyond doubt."""
    level = number_in(message, "percentage")
    if level is None or not 0 < level <= 100:  # noqa: PLR2004
        return None
    if level > MAX_FRACTION:
        return "percent"
    charged = _charged(message)
    if charged is not None and charged > SAME_LEVEL:
        return "fraction" if abs(charged - level) < SAME_LEVEL else None
    if level >= NEARLY_ONE and message.get("power_supply_status") == FULL:
        return "fraction"
    fits, fits_empty = _fits_voltage(level, message), _fits_voltage(level / 100, message)
    return "fraction" if fits and not fits_empty else None


def _charged(message: JsonObject) -> float | None:
    charge, capacity = number_in(message, "charge"), number_in(message, "capacity")
    return charge / capacity if charge is not None and capacity else None


def _fits_voltage(level: float, message: JsonObject) -> bool:
    """Whether some pack of cells has this voltage at this level, from 0 to 1."""
    volts = number_in(message, "voltage")
    if volts is None or volts <= 0:
        return False
    for (empty_low, empty_high), (full_low, full_high) in CELLS:
        low = empty_low + (full_low - empty_low) * level
        high = empty_high + (full_high - empty_high) * level
        if math.floor(volts / low) >= max(1, math.ceil(volts / high)):
            return True
    return False

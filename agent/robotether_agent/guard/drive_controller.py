"""Takes drive messages from all connections, checks and limits them, and sends them and the guard's zeros.

Made by the guard's process, called by client proxies, run as one task. It alone decides what is published. Of each
topic only the newest command waits when rosbridge is busy, and not beyond its age. It must never send a zero where
nobody has driven through this guard.
"""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Callable, Iterable, Mapping

from robotether_common.guard import REFUSED_KINDS, STAMP, STOP_CAUSES, RefusedKind, StopCause

from robotether_agent.guard.agent_messages import LISTENERS_UNKNOWN, UNHEARD, GuardConfig
from robotether_agent.guard.authorizer import Authorizer
from robotether_agent.guard.drive_messages import (
    SHAPES,
    CheckedCommand,
    DriveMessage,
    DriveMessageRefusedError,
    MessageId,
    Shape,
    limited,
    message_id,
    read_command,
    slowed,
    write_command,
    zero,
)
from robotether_agent.guard.rosbridge import CmdVelPublisher
from robotether_agent.guard.seen_age import FrameTimes, SeenAges, SeenFrames
from robotether_agent.guard.topics import (
    CommandSource,
    Deadman,
    Driven,
    MotionFile,
    PendingCommand,
    Topic,
    Topics,
)
from robotether_agent.problems import StateUnusableError

# Maximum time by which a timestamp may be ahead, for the drift of two clocks; more would hide an
# age.
AHEAD_MS = 100.0
# Time after its last use for which a topic counts as driven.
DRIVEN_FOR_S = 10.0
# Time after a command without another one, after which it is slowed as what its driver saw grows old.
SLOWED_EVERY_S = 0.1
# Number of the event loop's turns in which a line of the agent that has come is read.
TURNS_TO_READ = 5
# Time within which rosbridge and ROS register a topic that was advertised.
REGISTERED_WITHIN_S = 2.0
# Time after which rosbridge registers an unadvertised topic again; its unregister_timeout is 10 s.
UNREGISTERED_AFTER_S = 12.0

log = logging.getLogger(__name__)


class DriveController:
    """Decides what the publisher sends; implements `rosbridge.PublisherListener`."""

    def __init__(
        self,
        publisher: CmdVelPublisher,
        authorizer: Authorizer,
        motion_file: MotionFile,
        clock: Callable[[], float],
        changed: Callable[[], None],
    ) -> None:
        self.refusals: dict[RefusedKind, int] = dict.fromkeys(REFUSED_KINDS, 0)
        # Number of times that the guard stopped a robot that moved.
        self.stops: dict[StopCause, int] = dict.fromkeys(STOP_CAUSES, 0)
        self._publisher = publisher
        self._authorizer = authorizer
        self._motion = motion_file
        self._clock = clock
        self._changed = changed
        self._config = GuardConfig("")
        self._deadman = Deadman(self._config.deadman_s)
        self._topics = Topics()
        self.frame_times = FrameTimes()
        self.seen_ages = SeenAges()
        self._driver: CommandSource | None = None
        self._wake = asyncio.Event()
        self._stepped = asyncio.Event()
        self._fence = 0
        # Drive topics to which rosapi knows no listener; None: it does not say. Whether it knows all listeners.
        self.unheard: frozenset[str] | None = frozenset()
        self._is_unheard_sure = True

    # What changes from outside.

    @property
    def moving(self) -> bool:
        """Whether the robot moves, or is not known to be at rest yet."""
        return self._deadman.state != "idle"

    def use(self, config: GuardConfig) -> None:
        """Use these settings from now on."""
        self._config = config
        self._deadman.timeout_s = config.deadman_s
        self._topics.named = frozenset(config.topics.plain())

    def resume(self) -> None:
        """Zero what a guard before this one left in motion; call once, with the settings known."""
        left = self._motion.read()
        if left is None:
            return
        left = left or [Driven(name, "unknown") for name in self._config.topics.plain()]
        for driven in left:
            topic = self._topics.add(driven.topic)
            topic.type, topic.sent = driven.type, zero(driven.shape, driven.frame_id)
            topic.moved = True
        names = [driven.topic for driven in left]
        log.warning(
            "the last guard ended while the robot moved: zeroing %s", ", ".join(names) or "nothing"
        )
        self._motion.adopt(left)
        self.stops["fault"] += 1
        self._deadman.force(names, self._clock())
        # rosbridge may have forgotten the last guard's publisher.
        self._deadman.restart_zeros()
        self._wake.set()

    def stop(self) -> None:
        """Zero every topic that was driven since the start, whoever drives it now."""
        self._topics.forget_waiting(lambda _: True)
        driven = [topic.name for topic in self._topics if topic.sent is not None]
        self._count_stop(driven, "person")
        self._deadman.force(driven, self._clock())
        self._wake.set()

    def halt(self) -> None:
        """Zero what moves."""
        self._topics.forget_waiting(lambda _: True)
        self._count_stop(self._deadman.moving(), "fault")
        self._begin_zeros(self._deadman.moving())

    def rights_changed(self) -> None:
        """Zero what a connection moves that may not drive any more."""
        self._lost(lambda source: not self._authorizer.holds(source.authorization))

    def on_disconnected(self, source: CommandSource) -> None:
        """Zero what this connection moves: it is no more."""
        self._lost(lambda other: other is source)
        if self._driver is source:
            self._driver = None

    async def until_at_rest(self) -> None:
        """Return when the robot has got its zeros."""
        while self.moving:
            self._stepped.clear()
            await self._stepped.wait()

    def close(self) -> None:
        """Remove the motion file if the robot is at rest; the guard ends."""
        if not self.moving:
            self._motion.end(self._clock())

    def on_rosbridge_connected(self) -> None:
        """Advertise the topics at this rosbridge and send it what is owed."""
        self._deadman.hurry(self._clock())
        self._wake.set()

    def on_rosbridge_drained(self) -> None:
        """Send what waits."""
        waits = self._topics.parting or any(topic.waiting for topic in self._topics)
        if waits or self._deadman.owes:
            self._deadman.hurry(self._clock())
            self._wake.set()

    def on_rosbridge_lost(self) -> None:
        """Owe zeros to the next rosbridge: nobody knows what this one did last."""
        self._topics.on_rosbridge_lost()
        self.halt()
        # Also where the last command was zero: that may be what was lost.
        unread = [t.name for t in self._topics if t.sent and t.sent_at > self._publisher.read_until]
        self._deadman.force(unread, self._clock())
        self._deadman.restart_zeros()

    def on_rosbridge_message(self, data: bytes) -> None:
        """Notify the driver, who would have received it from rosbridge."""
        if self._driver is not None:
            self._driver.notify(data)

    def driven_now(self) -> list[str]:
        """Name the topics that somebody drives, and that rosbridge has had time to register."""
        now = self._clock()
        registered = (
            t for t in self._topics if t.announced and now >= t.announced_at + REGISTERED_WITHIN_S
        )
        return [t.name for t in registered if now < t.used_at + DRIVEN_FOR_S]

    def on_unheard(self, names: frozenset[str] | None, *, is_sure: bool = True) -> None:
        """Refuse to move what surely nothing listens to; zeros always go, and what is not sure is said."""
        self._is_unheard_sure = is_sure
        if names == self.unheard:
            return
        for name in sorted((names or frozenset()) - (self.unheard or frozenset())):
            self._warn(f"{UNHEARD} {name}", to_driver=not is_sure)
        if names is None:
            self._warn(LISTENERS_UNKNOWN, to_driver=True)
        self.unheard = names
        self._changed()

    def _warn(self, text: str, *, to_driver: bool) -> None:
        log.warning(text)
        if to_driver:
            self.on_rosbridge_message(_json({"op": "status", "level": "error", "msg": text}))

    def on_unregistered(self, name: str) -> None:
        """Advertise a topic at rest anew, once rosbridge has forgotten it."""
        topic = self._topics.find(name)
        if topic is not None and topic.waiting is None and self._deadman.is_at_rest(name):
            log.warning("ROS has forgotten that rosbridge publishes %s; advertising it again", name)
            self._topics.withhold(topic, self._clock() + UNREGISTERED_AFTER_S)
            self._wake.set()

    # Messages.

    async def handle(self, source: CommandSource, message: DriveMessage) -> None:
        """Do what a message on a drive topic asks for, or refuse it."""
        try:
            await self._dispatch(source, message)
        except DriveMessageRefusedError as refused:
            doing = "publish to" if message.operation == "publish" else message.operation
            text = f"cannot {doing} {message.topic}: {refused.why}"
            self.refuse(source, refused.kind, text, message_id(message.fields))

    def refuse(
        self, source: CommandSource, kind: RefusedKind, text: str, identity: MessageId
    ) -> None:
        """Count a refusal and answer it."""
        self.refusals[kind] += 1
        source.refuse(kind, text, identity)

    async def _dispatch(self, source: CommandSource, message: DriveMessage) -> None:
        if source.authorization.mode == "observe":
            raise DriveMessageRefusedError("fence", "this connection only observes")
        self._welcome(source)
        if message.operation == "advertise":
            await self._advertise(source, message)
        elif message.operation == "publish":
            await self._publish(source, message)

    def _welcome(self, source: CommandSource) -> None:
        """Let a new driver begin without the names that the one before invented."""
        fence = source.authorization.fence
        if fence not in (0, self._fence) and self._authorizer.holds(source.authorization):
            self._fence = fence
            self._topics.free_unmoved(self._is_removable)
            self._wake.set()

    def _topic_for(self, source: CommandSource, name: str) -> Topic:
        """Return the topic of this name; when all are in use, only who may drive replaces another."""
        is_removable = (
            self._is_removable if self._authorizer.holds(source.authorization) else lambda _: False
        )
        topic = self._topics.ensure(name, self._clock(), is_removable)
        if self._topics.parting:
            self._deadman.forget(self._topics)
            self._wake.set()
        return topic

    def _is_removable(self, topic: Topic) -> bool:
        """Return whether a topic is at rest, and rosbridge has read so: no zero is owed to it, nor may be soon."""
        is_at_rest = topic.waiting is None and self._deadman.is_at_rest(topic.name)
        return is_at_rest and (topic.sent is None or topic.sent_at <= self._publisher.read_until)

    async def _advertise(self, source: CommandSource, message: DriveMessage) -> None:
        # The field latch is left out: a robot must not get its last command again by itself.
        name = message.fields.get("type")
        if not isinstance(name, str) or name not in SHAPES:
            raise DriveMessageRefusedError(
                "shape", "its type is not a Twist, TwistStamped or AckermannDriveStamped"
            )
        topic = self._topic_for(source, message.topic)
        self._check_shape(topic, SHAPES[name])
        if topic.type != name:
            topic.type, topic.announced = name, False
        await self._announce(topic)

    async def _publish(self, source: CommandSource, message: DriveMessage) -> None:
        raw_stamp = message.fields.get(STAMP)
        stamp: Mapping[str, object] = raw_stamp if isinstance(raw_stamp, dict) else {}
        await self._read_frames(stamp.get("seen"))
        now = self._clock()
        self._authorizer.check(source.authorization, stamp.get("fence"), now)
        seen = self._seen_frames(source, stamp, now)
        topic = self._topics.find(message.topic)
        command = read_command(message.fields.get("msg", {}), topic.declared if topic else None)
        try:
            old_at = self._old_at(source, stamp.get("t_ms"), now)
            if topic is not None:
                self._check_shape(topic, command.shape)
        except DriveMessageRefusedError:
            if topic is not None and not command.moves:
                # However late it comes, and as what, the driver wants to stop.
                topic.waiting = None
                self._begin_zeros([topic.name])
            raise
        topic = self._topic_for(source, message.topic)
        is_unheard = self._is_unheard_sure and topic.name in (self.unheard or ())
        if now < topic.withheld_until or (command.moves and is_unheard):
            raise DriveMessageRefusedError("held", f"nothing on the robot listens to {topic.name}")
        before = topic.sent if self._deadman.is_moving(topic.name) else None
        command = limited(command, before, now - topic.sent_at, self._config.limits)
        if topic.waiting is not None:
            self.refusals["old"] += 1
        identity = message_id(message.fields)
        topic.waiting = PendingCommand(command, source, old_at, identity, seen)
        await self._send_waiting(topic)
        if topic.waiting is not None:
            self._wake.set()

    async def _read_frames(self, seen: object) -> None:
        """Let the agent's lines be read that came before a command on another connection, and report its frames."""
        for _ in range(TURNS_TO_READ):
            if not self.frame_times.may_follow(seen, self._clock()):
                return
            await asyncio.sleep(0)

    def _seen_frames(
        self, source: CommandSource, stamp: Mapping[str, object], now: float
    ) -> SeenFrames | None:
        """Return what the driver saw; a client that has named frames once is one that names them."""
        view = source.view
        view.names_frames = view.names_frames or "seen" in stamp
        if not (view.names_frames or self._config.blind.needs_frames):
            return None
        taken_s = self.frame_times.oldest_s(stamp.get("seen"), now)
        return SeenFrames(taken_s, view, source.authorization.fence)

    def _check_shape(self, topic: Topic, shape: Shape) -> None:
        """Refuse another shape than the robot is moved with: it may not take it, and would drive on."""
        if self._deadman.is_at_rest(topic.name) or topic.sent is None:
            return
        if shape != topic.sent.shape:
            raise DriveMessageRefusedError(
                "shape", "the robot moves by another message type on this topic"
            )

    def _old_at(self, source: CommandSource, t_ms: object, now: float) -> float:
        """Return until when a command may be sent, or refuse it."""
        if not self._publisher.up or self._deadman.owes:
            raise DriveMessageRefusedError("held", "rosbridge does not accept commands")
        if source.authorization.mode == "direct":
            return now + self._config.max_age_s
        if isinstance(t_ms, bool) or not isinstance(t_ms, int | float):
            raise DriveMessageRefusedError("old", "its timestamp is missing or is not a number")
        # In this order nothing passes that is no timestamp, and no integer becomes a float that is too large.
        if not now * 1000 - self._config.max_age_s * 1000 <= t_ms <= now * 1000 + AHEAD_MS:
            raise DriveMessageRefusedError(
                "old", f"it is not of the last {self._config.max_age_s * 1000:g} ms"
            )
        return min(t_ms / 1000, now) + self._config.max_age_s

    # Sending.

    async def run(self) -> None:
        """Send what is due, without end."""
        loop = asyncio.get_running_loop()
        while True:
            self._wake.clear()
            await self.step()
            due_at = self._next_at()
            delay_s = None if due_at is None else max(0.0, due_at - self._clock())
            timer = None if delay_s is None else loop.call_later(delay_s, self._wake.set)
            try:
                await self._wake.wait()
            finally:
                if timer is not None:
                    timer.cancel()

    async def step(self) -> None:
        """Send the zeros and commands whose time has come."""
        now = self._clock()
        has_work = self._deadman.moving() or any(topic.waiting for topic in self._topics)
        if has_work and now >= self._authorizer.silent_at:
            # Only then: it wakes this loop, which would turn without a pause for as long as the agent is silent.
            self.halt()
        due = self._deadman.due(now)
        self.stops["silence"] = self._deadman.silences
        for name in due:
            await self._zero(self._topics.add(name), now)
        await self._unadvertise()
        for topic in self._topics:
            await self._announce(topic)
            await self._send_waiting(topic)
            await self._slow_down(topic)
        self._motion.tend(now, moves=self.moving)
        self._stepped.set()
        self._changed()

    async def _announce(self, topic: Topic) -> None:
        is_due = topic.type and not topic.announced and self._clock() >= topic.withheld_until
        if is_due and self._publisher.can_send:
            advertise = {"op": "advertise", "topic": topic.name, "type": topic.type}
            # Meanwhile it may be forgotten, and then rosbridge must be notified.
            topic.announced, topic.announced_at = True, self._clock()
            if not await self._publisher.send(_json(advertise)):
                topic.announced = False

    async def _unadvertise(self) -> None:
        while self._topics.parting and self._publisher.can_send:
            forgotten = {"op": "unadvertise", "topic": self._topics.next_parting()}
            await self._publisher.send(_json(forgotten))

    async def _zero(self, topic: Topic, now: float) -> None:
        topic.waiting = None
        if topic.sent is not None and self._publisher.can_send:
            topic.withheld_until = 0.0
            await self._announce(topic)
            command = zero(topic.sent.shape, topic.sent.frame_id)
            self._count_slowed(topic, now)
            if await self._publisher.send(_publish(topic, command, None)):
                topic.sent, topic.sent_at = command, now
                self._deadman.zeroed(topic.name, now)
                return
        self._deadman.postponed(topic.name, now)

    async def _send_waiting(self, topic: Topic) -> None:
        """Send the newest command of a topic if rosbridge takes it now; drop it if it is old."""
        waiting, now = topic.waiting, self._clock()
        if waiting is None:
            return
        if now > waiting.old_at:
            topic.waiting = None
            self._drop_old(topic, waiting, now)
        elif self._publisher.can_send and not self._deadman.owes:
            await self._announce(topic)
            # Meanwhile a stop may have come, or a newer command.
            if topic.waiting is waiting:
                topic.waiting = None
                await self._send(topic, waiting)

    async def _send(self, topic: Topic, waiting: PendingCommand) -> None:
        command = waiting.command
        was_moving = self._deadman.is_moving(topic.name)
        if command.moves and not was_moving:
            moving = Driven(topic.name, command.shape, topic.type, command.frame_id)
            try:
                self._motion.ensure(moving, self._topics)
            except StateUnusableError as problem:
                why = f"the guard {problem.message}"
                self.refuse(waiting.source, "held", _cannot(topic, why), waiting.message_id)
                return
            self._wake.set()
        if waiting.seen is not None and topic.seen is None:
            # From now on it is looked at now and then.
            self._wake.set()
        now = self._clock()
        self._driver = topic.source = waiting.source
        topic.seen = waiting.seen if command.moves else None
        command = self._seen_and_slowed(topic, command, now)
        topic.sent, topic.sent_at = command, now
        if command.moves:
            # Before it is sent: if the connection breaks meanwhile, it may have arrived.
            self._deadman.commanded(topic.name, now, moves=True)
            topic.moved = True
        sent = await self._publisher.send(_publish(topic, command, waiting.message_id))
        if sent and not command.moves and topic.sent is command:
            self._deadman.commanded(topic.name, now, moves=False)
            self._wake.set()

    async def _slow_down(self, topic: Topic) -> None:
        """Send the last command again, slower, if none comes while what its driver saw grows old."""
        seen, now = self._seen_in_motion(topic), self._clock()
        if seen is None or topic.sent is None or now < topic.slow_at:
            return
        topic.slow_at = now + SLOWED_EVERY_S
        if self._deadman.owes or not self._publisher.can_send:
            return
        command = self._within_limits(seen, topic.sent, now)
        if command != topic.sent:
            self._count_slowed(topic, now)
            topic.is_slowed = seen.fence > 0
            topic.sent, topic.sent_at = command, now
            await self._publisher.send(_publish(topic, command, None))

    def _seen_in_motion(self, topic: Topic) -> SeenFrames | None:
        """Return what somebody saw at the last command, by which the robot moves on, if that is limited."""
        is_limited = self._config.blind.any and self._deadman.is_moving(topic.name)
        return topic.seen if is_limited else None

    def _seen_and_slowed(self, topic: Topic, command: CheckedCommand, now: float) -> CheckedCommand:
        """Return a new command as fast as its driver's view allows, and count both for the drive's record."""
        self._count_slowed(topic, now)
        topic.slow_at = now + SLOWED_EVERY_S
        if (seen := topic.seen) is None:
            return command
        self.seen_ages.begin(seen.fence)
        self.seen_ages.limits = None
        allowed = self._within_limits(seen, command, now)
        if seen.fence:
            self.seen_ages.add(seen.age_s(now))
            topic.is_slowed = allowed != command
        return allowed

    def _within_limits(
        self, seen: SeenFrames, command: CheckedCommand, now: float
    ) -> CheckedCommand:
        """Return the command as fast as what its driver saw allows now."""
        age_s = seen.limiting_age_s(now)
        speed, turn = self._config.blind.speed(age_s), self._config.blind.turn(age_s)
        allowed = slowed(command, speed, turn)
        if allowed != command:
            self.seen_ages.limits = (speed, turn)
        return allowed

    def _count_slowed(self, topic: Topic, now: float) -> None:
        """Count for how long the command before was slowed."""
        if topic.is_slowed:
            self.seen_ages.slowed_s += now - topic.sent_at
        topic.is_slowed = False

    def _drop_old(self, topic: Topic, waiting: PendingCommand, now: float) -> None:
        why = "rosbridge did not accept it in time"
        self.refuse(waiting.source, "old", _cannot(topic, why), waiting.message_id)
        if not waiting.command.moves:
            # The driver wanted to stop, and there is nothing newer.
            self._deadman.stop([topic.name], now)

    def _lost(self, concerned: Callable[[CommandSource], bool]) -> None:
        self._topics.forget_waiting(concerned)
        names = self._topics.of(concerned)
        self._count_stop(names, "lost")
        self._begin_zeros(names)

    def _count_stop(self, names: Iterable[str], cause: StopCause) -> None:
        """Count that the robot is stopped if any of these topics moves it."""
        if any(map(self._deadman.is_moving, names)):
            self.stops[cause] += 1

    def _begin_zeros(self, names: Iterable[str]) -> None:
        self._deadman.stop(names, self._clock())
        self._wake.set()

    def _next_at(self) -> float | None:
        times = [topic.waiting.old_at for topic in self._topics if topic.waiting]
        due = self._deadman.next_at()
        if due is not None:
            times.append(due)
        if self._deadman.moving():
            times.append(self._authorizer.silent_at)
        times += [topic.slow_at for topic in self._topics if self._seen_in_motion(topic)]
        now = self._clock()
        times += [t.withheld_until for t in self._topics if t.withheld_until > now]
        if self._motion.ends_at is not None and not self.moving:
            times.append(self._motion.ends_at)
        return min(times, default=None)


def _cannot(topic: Topic, why: str) -> str:
    return f"cannot publish to {topic.name}: {why}"


def _publish(topic: Topic, command: CheckedCommand, identity: MessageId) -> bytes:
    message: dict[str, object] = {"op": "publish", "topic": topic.name}
    if identity is not None:
        message["id"] = identity
    message["msg"] = write_command(command)
    return _json(message)


def _json(message: Mapping[str, object]) -> bytes:
    return json.dumps(message, separators=(",", ":"), allow_nan=False).encode()

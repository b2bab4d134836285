"""Copies of what a robot sends, which all who want the same share: opened for the first, ended a while after the last.

`channels/video/feeds` and `channels/rosbridge/shared_topics` are such copies; each has a task that brings it what the
robot sends.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Coroutine, Hashable
from typing import Any, Generic, Protocol, TypeVar, cast

from robotether_server.db.fleet import RelayRobot
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.robot import Change, Robot
from robotether_server.tasks import end_tasks


class CopyUser(Protocol):
    """A connection that shares a copy."""

    def user_ids(self) -> Collection[int]:
        """Return whose it is; another cell's is its observers'."""


Key = TypeVar("Key", bound=Hashable)
User = TypeVar("User", bound=CopyUser)

# Time for which a copy stays without users, for a page that reloads or swaps its cameras; a feed
# must close within 1 s.
LINGER_S = 0.5


class SharedCopy(Generic[Key, User]):
    """One copy, and its users. `key` tells it from the robot's others of its kind."""

    def __init__(self, robot: RelayRobot, key: Key) -> None:
        self.robot = robot
        self.key = key
        self.users: set[User] = set()
        self.ended = asyncio.Event()
        # Until when it stays without users, by the loop's clock.
        self.kept_until_s = 0.0

    def user_ids(self) -> set[int]:
        """Return who shares it."""
        return {user_id for user in self.users for user_id in user.user_ids()}


Copy = TypeVar("Copy", bound=SharedCopy[Any, Any])


class SharedCopies(ABC, Generic[Copy]):
    """All copies of one kind. `copies_of` says where a robot holds them; `max_lingering` of one stay without users."""

    def __init__(
        self,
        registry: SessionRegistry,
        copies_of: Callable[[Robot], dict[Hashable, object]],
        *,
        max_lingering: int,
    ) -> None:
        self._registry = registry
        self._copies_of = copies_of
        self._max_lingering = max_lingering
        self._tasks: dict[Copy, asyncio.Task[None]] = {}
        # With those that are cancelled, which need some time to end.
        self._all: set[asyncio.Task[None]] = set()

    def count(self) -> int:
        """How many copies there are."""
        return len(self._tasks)

    def on_robot_change(self, change: Change) -> None:
        """Something happened to a robot; with its session end its copies."""
        if change.what == "disconnected":
            self.end_all_of(change.robot_id)

    def end_all_of(self, robot_id: int) -> None:
        """End a robot's copies: there is no way to it."""
        for copy in list(self._of(robot_id).values()):
            self._on_link_lost(copy)
            self._end(copy)

    async def close(self) -> None:
        """End all; the relay stops."""
        await end_tasks(self._all)

    @abstractmethod
    async def _bring(self, copy: Copy) -> None:
        """Bring a copy what the robot sends, until this is cancelled or there is no more."""

    def _on_link_lost(self, copy: Copy) -> None:
        """Do what else a robot that disconnected means to a copy."""

    def _of(self, robot_id: int) -> dict[Hashable, Copy]:
        # Nobody else makes one.
        return cast(dict[Hashable, Copy], self._copies_of(self._registry.robot(robot_id)))

    def _open(self, copy: Copy) -> Copy:
        self._copies_of(self._registry.ensure_robot(copy.robot.id))[copy.key] = copy
        self._tasks[copy] = self._start(self._run(copy))
        return copy

    def _start(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task: asyncio.Task[None] = asyncio.create_task(work)
        self._all.add(task)
        task.add_done_callback(self._all.discard)
        return task

    async def _run(self, copy: Copy) -> None:
        try:
            await self._bring(copy)
        finally:
            self._forget(copy)

    def _let_linger(self, copy: Copy, linger_s: float = LINGER_S) -> None:
        """End a copy without users, after a while in which somebody may come."""
        loop = asyncio.get_running_loop()
        until_s = copy.kept_until_s = max(copy.kept_until_s, loop.time() + linger_s)
        if copy.users:
            return
        unused = [each for each in self._of(copy.robot.id).values() if not each.users]
        if len(unused) > self._max_lingering:
            self._end(copy)
        else:
            loop.call_at(until_s, self._end_unused, copy, until_s)

    def _end_unused(self, copy: Copy, until_s: float) -> None:
        # Whoever left since may have let it stay for longer.
        if not copy.users and copy.kept_until_s == until_s:
            self._end(copy)

    def _end_any_unused(self, robot_id: int) -> bool:
        """End one copy without users, the oldest, to have room for another; return whether there was one."""
        unused = next((each for each in self._of(robot_id).values() if not each.users), None)
        if unused is not None:
            self._end(unused)
        return unused is not None

    def _end(self, copy: Copy) -> None:
        task = self._tasks.get(copy)
        self._forget(copy)
        if task is not None:
            task.cancel()

    def _forget(self, copy: Copy) -> None:
        """Let the next who wants the same open a new one."""
        copy.ended.set()
        self._tasks.pop(copy, None)
        copies = self._of(copy.robot.id)
        if copies.get(copy.key) is copy:
            del copies[copy.key]

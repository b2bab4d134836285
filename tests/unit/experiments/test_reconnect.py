"""The restart of a server's containers, and the steps that measure the fleet's return."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import pytest
from paper import reconnect
from paper.fleet import SERVICES
from paper.step import Scale

TOGETHER_S = 20


class World:
    """Containers that restart only all at once; `broken` are those that cannot."""

    def __init__(self, count: int, broken: str = "") -> None:
        self.restarted: dict[str, int] = {}
        self._broken = broken
        self._together = threading.Barrier(count)

    def container(self, service: str) -> SimpleNamespace:
        """One that notes its restart."""

        def restart(timeout: int) -> None:
            self._together.wait(TOGETHER_S)
            self.restarted[service] = timeout
            if service == self._broken:
                raise RuntimeError(f"{service} does not start")

        return SimpleNamespace(restart=restart)


def test_containers_are_killed_and_started_all_at_once():
    """As by a loss of power: none gets time to say goodbye."""
    world = World(len(SERVICES))
    reconnect.restart_services(world, SERVICES)
    assert world.restarted == dict.fromkeys(SERVICES, 0)


def test_a_container_that_does_not_start_fails_the_step():
    """Nothing could be measured then."""
    with pytest.raises(RuntimeError, match="relay does not start"):
        reconnect.restart_services(World(2, broken="relay"), ["relay", "sshd"])


@pytest.mark.parametrize(("scale", "counts"), [(Scale(quick=True), {10}), (Scale(), {50, 200})])
def test_each_size_loses_its_tunnels_and_its_whole_server(scale, counts):
    """Both kinds of restarts, once each."""
    names = {step.name for step in reconnect.steps(scale)}
    assert names == {f"reconnect-{n}-{what}" for n in counts for what in reconnect.RESTARTS}

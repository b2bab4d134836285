"""Containers beside our nginx on networks of their own, without the other parts of the stack."""

from __future__ import annotations

import uuid
from contextlib import ExitStack, suppress
from functools import partial
from typing import Any

import docker
from docker.errors import NotFound
from docker.models.containers import Container


class Containers(ExitStack):
    """They are gone at the end of its `with` block, as their networks are."""

    def __init__(self) -> None:
        super().__init__()
        self._engine = docker.from_env()
        self.callback(self._engine.close)

    def network(self) -> Any:
        made = self._engine.networks.create(f"robotether-nginx-{uuid.uuid4().hex[:8]}")
        self.callback(made.remove)
        made.reload()
        return made

    def volume(self) -> Any:
        made = self._engine.volumes.create()
        self.callback(partial(made.remove, force=True))
        return made

    def start(self, network: Any, name: str, *aliases: str, **options: Any) -> Container:
        """A container that others on its network find under these names."""
        own = self._engine.api.create_endpoint_config(aliases=list(aliases))
        container: Container = self._engine.containers.create(
            name, network=network.name, networking_config={network.name: own},
            **{"tmpfs": {"/run/nginx": "uid=33,gid=33"}, **options},
        )  # fmt: skip
        self.callback(remove, container)
        container.start()
        return container


def remove(container: Container) -> None:
    with suppress(NotFound):
        container.remove(force=True, v=True)


def address_in(network: Any, container: Container) -> str:
    container.reload()
    return str(container.attrs["NetworkSettings"]["Networks"][network.name]["IPAddress"])

"""Containers and addresses as the Docker engine of this machine knows them."""

from __future__ import annotations

import docker
from docker.models.containers import Container


def container_of(engine: docker.DockerClient, project: str, service: str) -> Container:
    labels = [f"com.docker.compose.project={project}", f"com.docker.compose.service={service}"]
    found = engine.containers.list(all=True, filters={"label": labels})
    assert len(found) == 1, f"{len(found)} containers of service {service}"
    return found[0]


def address_of(container: Container) -> str:
    """The address of a container in one of its networks, which this machine reaches and nobody else does."""
    networks = container.attrs["NetworkSettings"]["Networks"]
    return str(next(iter(networks.values()))["IPAddress"])


def machine_address(engine: docker.DockerClient) -> str:
    """This machine's address at which published ports answer as they do to the network and to containers.

    Not localhost, which Docker serves by a proxy process of its own: from outside no such process is in the way.
    """
    return str(engine.networks.get("bridge").attrs["IPAM"]["Config"][0]["Gateway"])

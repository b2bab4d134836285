"""A site of cells on this machine: a compose project each, with the database in the first one.

They reach each other by published ports of this machine's address on Docker's bridge.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from docker_engine import machine_address
from local_network import free_port
from mariadb_server import engine
from stack import PROJECT, Stack


def _settings(name: str, compose_file: str, host: str) -> dict[str, object]:
    peer_port = free_port()
    return {
        "COMPOSE_FILE": f"compose.yaml:{compose_file}",
        "CELL": name,
        "REGION": f"at-{name}",
        "PUBLIC_HOST": host,
        "PEER_PORT": peer_port,
        "PEER_ADDRESS": f"{host}:{peer_port}",
        "DB_HOST": host,
    }


def first_cell(folder: Path, name: str = "a") -> Stack:
    """Cell a, or another, which has a database; not yet started."""
    port = free_port()
    with engine() as docker_engine:
        settings = _settings(name, "database.yaml", machine_address(docker_engine))
    published = {"DB_PORT": port, "DB_PUBLISH": f"{settings['DB_HOST']}:{port}"}
    return Stack(folder, project=f"{PROJECT}-{name}", settings=settings | published)


@contextmanager
def second_cell(
    first: Stack, name: str = "b", *, prepare: Callable[[Stack], None] = lambda _: None
) -> Iterator[Stack]:
    """Cell b, or another, of the site of the first, which runs: started without robots, and removed at the end."""
    folder = first.folder / name
    settings = _settings(name, "cell.yaml", str(first.settings["DB_HOST"]))
    settings["DB_PORT"] = first.settings["DB_PORT"]
    cell = Stack(folder, project=f"{PROJECT}-{name}", settings=settings, is_built=True)
    first.tool("tools/site_secrets", str(folder / "secrets"))
    prepare(cell)
    try:
        cell.up(robots=False)
        yield cell
    finally:
        cell.down()

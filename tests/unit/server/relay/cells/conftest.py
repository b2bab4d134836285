"""A site of two cells, a and b, that follow each other."""

import pytest
import pytest_asyncio
from relay_server import until
from robotether_server.relay.cells.keys import read_peer_keys
from site_cells import Site, make_peer_keys


@pytest.fixture(scope="session")
def keys_dir(tmp_path_factory):
    return make_peer_keys(tmp_path_factory.mktemp("peer_keys"))


@pytest.fixture
def peer_keys(keys_dir):
    keys = read_peer_keys(keys_dir)
    assert keys is not None
    return keys


@pytest_asyncio.fixture
async def site(keys_dir, peer_keys, memory_database):
    site = Site(keys_dir, memory_database)
    for name in ("a", "b"):
        await site.add(name, peer_keys)
    yield site
    await site.stop()


@pytest.fixture
def cell_a(site):
    return site.cells["a"]


@pytest.fixture
def cell_b(site):
    return site.cells["b"]


@pytest_asyncio.fixture
async def at_b(cell_a, cell_b, sim1):
    """Robot sim1 at cell b, as cell a knows."""
    robot = await cell_b.robot(sim1, epoch=1)
    await until(lambda: cell_a.owner(sim1) == "b", "a knows of it")
    yield robot
    await robot.stop()

"""How a cell finds the others: whom it accepts, and how soon it is back."""

from dataclasses import replace

import pytest
from fake_robot import HOST
from relay_server import until
from robotether_server.relay.cells.keys import read_peer_keys
from site_cells import PeerListener, make_peer_keys


def move(cell, to, address):
    for database in (cell.database, to.database):
        settings = database.cells[to.name]
        database.cells[to.name] = replace(settings, peer_address=address)
    to.relay._settings = replace(
        to.relay._settings, cell=replace(to.relay._settings.cell, peer_address=address)
    )
    to.relay.cells._settings = to.relay._settings.cell


async def test_another_cell_at_the_address_is_none(cell_a, cell_b, caplog):
    move(cell_a, cell_b, f"{HOST}:{cell_a.listener.port}")
    await until(lambda: "a answers there; check PEER_ADDRESS" in caplog.text, "the log says so")
    await until(lambda: cell_a.relay.peers.count() == 0, "nobody is followed")


@pytest.mark.parametrize("side", ["listener", "dialer"])
async def test_only_the_sites_own_certificate_is_accepted(
    cell_a, cell_b, peer_keys, tmp_path, side
):
    folder = make_peer_keys(tmp_path)
    async with PeerListener(folder, peer_keys.proof, cell_b.relay.peer_port) as listener:
        if side == "listener":
            move(cell_a, cell_b, f"{HOST}:{listener.port}")
        else:
            cell_a.relay.peer_dialer._client.connector._ssl = read_peer_keys(folder).tls
            async with cell_b.listener.cut():
                await until(lambda: cell_a.relay.peers.count() == 0, "it is away")
        await until(lambda: cell_a.relay.peers.count() == 0, "b is not followed")
        with pytest.raises(AssertionError):
            await until(lambda: cell_a.relay.peers.count() == 1, "it is", within_s=1.5)

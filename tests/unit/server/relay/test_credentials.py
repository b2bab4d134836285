"""Logins and tokens: kept for seconds, held by what is live."""

from __future__ import annotations

import pytest
from relay_server import MemoryRecords
from robotether_server.problems import StoreUnavailable
from robotether_server.relay import credentials as module
from robotether_server.relay.credentials import Credentials, credential_of
from robotether_server.store.fleet import User

ANN = User(1, "ann")


@pytest.fixture
def credentials(records: MemoryRecords) -> Credentials:
    """Credentials with nothing kept."""
    return Credentials(records)


async def test_an_answer_is_kept_also_when_it_is_no(credentials, records):
    """The database is asked once for the same text, known or not."""
    good = credential_of("login", records.add_credential("login", ANN))
    bad = credential_of("login", "rubbish")
    for _ in range(3):
        assert await credentials.user_of(good) == ANN
        assert await credentials.user_of(bad) is None
    assert records.lookups == 2


async def test_what_is_kept_is_bounded(credentials, monkeypatch):
    """Many unknown texts push each other out."""
    monkeypatch.setattr(module, "MAX_KEPT", 10)
    for number in range(50):
        await credentials.user_of(credential_of("token", str(number)))
    assert len(credentials._kept) == 10


async def test_an_outage_is_told_and_not_kept(credentials, records):
    """While the database is away nobody is called unknown."""
    login = credential_of("login", records.add_credential("login", ANN))
    records.down = True
    with pytest.raises(StoreUnavailable):
        await credentials.user_of(login)
    records.down = False
    assert await credentials.user_of(login) == ANN


async def test_what_hangs_on_an_ended_credential_ends(credentials, records):
    """All holders of the ended one are told, nobody else."""
    gone = credential_of("login", records.add_credential("login", ANN))
    stays = credential_of("token", records.add_credential("token", ANN))
    ended: list[str] = []
    with (
        credentials.held(gone, lambda: ended.append("first")),
        credentials.held(gone, lambda: ended.append("second")),
        credentials.held(stays, lambda: ended.append("other")),
        credentials.held(None, lambda: ended.append("ticket")),
    ):
        await credentials.recheck()
        assert ended == []
        del records.credentials[gone]
        await credentials.recheck()
    assert sorted(ended) == ["first", "second"]


async def test_who_is_no_longer_live_is_not_told(credentials, records):
    """After the block nothing is held, and nothing is asked."""
    login = credential_of("login", "rubbish")
    with credentials.held(login, lambda: pytest.fail("not live any more")):
        pass
    await credentials.recheck()
    assert records.lookups == 0

"""Logins and tokens: kept for seconds, held by what is live."""

import asyncio

import pytest
from relay_server import ANN, MemoryDatabase
from robotether_server.problems import StoreUnavailableError, ThrottledError
from robotether_server.relay.auth import credentials as module
from robotether_server.relay.auth.credentials import Credentials, credential_of


@pytest.fixture
def credentials(memory_database):
    return Credentials(memory_database)


def of_ann(database, kind="login"):
    return credential_of(kind, database.add_credential(kind, ANN))


@pytest.fixture
def login(memory_database):
    return of_ann(memory_database)


async def unanswered(question):
    with pytest.raises(StoreUnavailableError):
        await question


async def test_an_answer_is_kept_also_when_it_is_no(credentials, memory_database):
    good = of_ann(memory_database)
    bad = credential_of("login", "rubbish")
    for _ in range(3):
        assert await credentials.user_of(good) == ANN
        assert await credentials.user_of(bad) is None
    assert memory_database.lookups == 2


async def test_what_is_kept_is_bounded(credentials, monkeypatch):
    monkeypatch.setattr(module, "MAX_KEPT", 10)
    for number in range(50):
        await credentials.user_of(credential_of("token", str(number)))
    assert len(credentials._cache) == 10


class SlowDatabase(MemoryDatabase):
    """Answers once the test lets it, with what was true when it was asked."""

    def __init__(self):
        super().__init__()
        self.questions = []
        self.asked, self.go_on = asyncio.Event(), asyncio.Event()
        self.is_slow = True

    async def users_of(self, credentials, *, briefly=False):
        self.questions.append(list(credentials))
        answer = await super().users_of(credentials, briefly=briefly)
        self.asked.set()
        if self.is_slow:
            await self.go_on.wait()
        return answer


def unknown(count, address="x"):
    return [credential_of("token", f"{address} {number}") for number in range(count)]


async def test_strangers_have_one_question_at_a_time():
    """However many they are, the next question is about all who came meanwhile. A stop waits for none of them."""
    database = SlowDatabase()
    credentials = Credentials(database)
    ann = of_ann(database, "token")
    # Of five addresses, as one has fewer places.
    asking = [
        asyncio.create_task(credentials.user_of(item, address))
        for address in "abcde"
        for item in unknown(40, address)
    ]
    await asyncio.sleep(0)
    stop = asyncio.create_task(credentials.user_of(ann, "a", stops=True))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert [len(asked) for asked in database.questions] == [100, 1]
    database.go_on.set()
    assert await stop == ANN
    assert await asyncio.gather(*asking) == [None] * 200
    assert [len(asked) for asked in database.questions] == [100, 1, 100]


async def test_an_address_has_few_places_and_takes_nobody_elses(monkeypatch):
    """Who has none is told to come again, not that the database is away; a stop has places of its own."""
    monkeypatch.setattr(module, "MAX_WAITING_OF_ADDRESS", 3)
    database = SlowDatabase()
    credentials = Credentials(database)
    asking = [asyncio.create_task(credentials.user_of(item, "x")) for item in unknown(3)]
    await asyncio.sleep(0)
    with pytest.raises(ThrottledError) as refused:
        await credentials.user_of(credential_of("token", "one more"), "x")
    assert refused.value.retry_after_s == 1
    asking += [
        asyncio.create_task(credentials.user_of(*asked, stops=stops))
        for asked, stops in [
            ((credential_of("token", "elsewhere"), "y"), False),
            ((credential_of("token", "stop"), "x"), True),
        ]
    ]
    await asyncio.sleep(0)
    database.go_on.set()
    assert await asyncio.gather(*asking) == [None] * 5
    # The places are free again; all addresses together have a bound, too.
    monkeypatch.setattr(module, "MAX_WAITING", 0)
    with pytest.raises(ThrottledError):
        await credentials.user_of(credential_of("token", "later"), "x")
    monkeypatch.undo()
    assert await credentials.user_of(credential_of("token", "later"), "x") is None


async def test_who_leaves_takes_nobodys_answer(credentials, memory_database, login):
    """Two requests with one credential have one question; the first of them is given up."""
    first, second = (asyncio.create_task(credentials.user_of(login)) for _ in range(2))
    await asyncio.sleep(0)
    first.cancel()
    assert await second == ANN
    assert memory_database.lookups == 1


async def test_what_hangs_on_an_ended_credential_ends(credentials, memory_database):
    gone = of_ann(memory_database)
    stays = of_ann(memory_database, "token")
    ended = []
    with (
        credentials.held(gone, lambda: ended.append("first")),
        credentials.held(gone, lambda: ended.append("second")),
        credentials.held(stays, lambda: ended.append("other")),
    ):
        await credentials.recheck()
        assert ended == []
        del memory_database.credentials[gone]
        await credentials.recheck()
    assert sorted(ended) == ["first", "second"]


async def test_what_ended_before_it_was_held_ends_too(credentials, memory_database):
    """The way from a ticket to its connection is long. An outage leaves it live, and in doubt."""
    gone = credential_of("login", "the login of somebody who has logged out")
    stays = of_ann(memory_database)
    ended = []
    with (
        credentials.held(gone, lambda: ended.append("gone")),
        credentials.held(stays, lambda: ended.append("stays")),
    ):
        memory_database.down = True
        await unanswered(credentials.check_new())
        assert ended == []
        memory_database.down = False
        await credentials.check_new()
        assert ended == ["gone"]
        asked = memory_database.lookups
        await credentials.check_new()
        assert memory_database.lookups == asked


async def test_who_drove_lately_may_drive_and_stop_while_the_database_is_away(
    credentials, memory_database, monkeypatch
):
    login, other, ended = (of_ann(memory_database) for _ in range(3))
    assert await credentials.holds(login)
    assert await credentials.holds(ended)
    del memory_database.credentials[ended]
    assert await credentials.user_of(ended) is None
    memory_database.down = True
    assert await credentials.holds(login)
    assert await credentials.user_of(login) == ANN
    for unknown_now in (other, ended):
        await unanswered(credentials.holds(unknown_now))
    monkeypatch.setattr(module, "RECENT_S", 0.0)
    await unanswered(credentials.holds(login))


@pytest.mark.parametrize(("asks", "yes"), [("holds", True), ("user_of", ANN)])
async def test_who_is_live_is_known_while_the_database_is_away(
    *, credentials, memory_database, login, monkeypatch, asks, yes
):
    """Whoever has a page open may drive and stop meanwhile, as long as that lasts and for a while after it."""
    monkeypatch.setattr(module, "KEEP_S", 0.0)
    ask = getattr(credentials, asks)
    with credentials.held(login, lambda: None):
        await credentials.check_new()
        memory_database.down = True
        monkeypatch.setattr(module, "RECENT_S", 0.0)
        assert await ask(login) == yes
    await unanswered(ask(login))
    monkeypatch.setattr(module, "RECENT_S", 60.0)
    assert await ask(login) == yes


async def test_what_may_have_ended_when_the_database_went_does_not_count(
    credentials, memory_database, login
):
    """Something has changed, and there is no answer as to what; a recheck of the time is no such change."""
    assert await credentials.holds(login)
    memory_database.down = True
    await unanswered(credentials.recheck(changed=False))
    assert await credentials.holds(login)
    await unanswered(credentials.recheck())
    await unanswered(credentials.holds(login))


@pytest.mark.parametrize("asks", ["holds", "check_new", "recheck"])
async def test_what_ended_by_any_answer_does_not_come_back(
    credentials, memory_database, login, asks
):
    with credentials.held(login, lambda: None):
        await credentials.check_new()
        assert await credentials.holds(login)
        del memory_database.credentials[login]
        with credentials.held(login, lambda: None):
            if asks == "holds":
                assert not await credentials.holds(login)
            else:
                await getattr(credentials, asks)()
        memory_database.down = True
        await unanswered(credentials.holds(login))


@pytest.mark.parametrize(("age_s", "is_believed"), [(0.0, True), (3.9, True), (4.1, False)])
async def test_a_ticket_newer_than_the_last_answer_is_believed_while_the_database_is_away(
    credentials, memory_database, login, age_s, is_believed
):
    """Another cell's web has asked the database since this relay last could."""
    memory_database.down = True
    credentials.note_signed(login, ANN, 0.0)
    # Not before a first answer.
    await unanswered(credentials.holds(login))
    memory_database.down = False
    await credentials.check_new()
    memory_database.down = True
    credentials._answered_at -= module.NEWER_BY_S + 4
    credentials.note_signed(login, ANN, age_s)
    if is_believed:
        assert await credentials.holds(login)
        assert await credentials.user_of(login) == ANN
    else:
        await unanswered(credentials.holds(login))


@pytest.mark.parametrize("asks", ["holds", "user_of", "recheck", "check_new", "lost recheck"])
async def test_no_ticket_of_before_an_answer_is_believed(credentials, memory_database, asks):
    """It may be the answer that the login has ended, or that something has, and then no more."""
    ended = credential_of("login", "the login of somebody who has logged out")
    await credentials.check_new()
    credentials._answered_at -= 3600
    with credentials.held(ended, lambda: None):
        memory_database.down = asks == "lost recheck"
        if asks in {"holds", "user_of"}:
            assert not await getattr(credentials, asks)(ended)
        elif memory_database.down:
            await unanswered(credentials.recheck())
        else:
            await getattr(credentials, asks)()
    memory_database.down = True
    credentials.note_signed(ended, ANN, 0.0)
    await unanswered(credentials.holds(ended))


async def test_who_a_ticket_made_known_is_asked_for_when_the_database_is_back(
    credentials, memory_database
):
    stays = of_ann(memory_database)
    ended = credential_of("login", "the login of somebody who has logged out")
    await credentials.check_new()
    credentials._answered_at -= 3600
    for login in (stays, ended):
        credentials.note_signed(login, ANN, 0.0)
        assert credentials.held_lately(login)
    await credentials.recheck()
    assert credentials.held_lately(stays)
    assert not credentials.held_lately(ended)


@pytest.mark.parametrize("asks", ["holds", "user_of"])
async def test_an_answer_of_before_a_change_is_not_kept(asks):
    memory_database = SlowDatabase()
    credentials = Credentials(memory_database)
    login = of_ann(memory_database)
    asking = asyncio.create_task(getattr(credentials, asks)(login))
    await memory_database.asked.wait()
    memory_database.credentials.clear()
    await credentials.recheck()
    memory_database.go_on.set()
    assert await asking
    memory_database.down = True
    await unanswered(getattr(credentials, asks)(login))


async def test_who_comes_during_a_recheck_is_not_ended_by_it():
    """The answer tells nothing of a credential that was not in the question, and who begins to drive is known."""
    memory_database = SlowDatabase()
    credentials = Credentials(memory_database)
    login, late = of_ann(memory_database), of_ann(memory_database)
    with credentials.held(login, lambda: pytest.fail("it holds")):
        recheck = asyncio.create_task(credentials.recheck())
        await memory_database.asked.wait()
        memory_database.is_slow = False
        with credentials.held(late, lambda: pytest.fail("it holds, too")):
            assert await credentials.holds(late)
            memory_database.go_on.set()
            await recheck
    memory_database.down = True
    assert await credentials.holds(late)

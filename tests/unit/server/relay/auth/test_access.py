"""Who may open what, without a network; the handlers' tests show the answers to those who may not."""

import time
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from relay_server import MemoryDatabase, relay_settings, utc
from robotether_server.db.fleet import RelayRobot, RelayUser, Snapshot
from robotether_server.problems import (
    GrantMissingError,
    LoginMissingError,
    OriginRefusedError,
    RobotUnknownError,
    StoreUnavailableError,
    TicketExpiredError,
    TicketForeignError,
    TicketUsedError,
    TokenInvalidError,
)
from robotether_server.relay.auth.access import Access, Permit, Request, UsedTickets
from robotether_server.relay.auth.credentials import Credentials, credential_of
from robotether_server.settings.server import TicketSettings
from robotether_server.tickets import Ticket, TicketSigner, new_id

START = utc(2026, 1, 1, 12, 0)


def later(seconds):
    return START + timedelta(seconds=seconds)


def access_of(database, granted="observe", credentials=None, *, online_s=lambda _robot_id: None):
    """Robot 7 is sim1, robot 8 is sim2, and user 3 has this grant on them."""
    robot = RelayRobot(7, "sim1", "active", 20000, 20001, MAC)
    other = RelayRobot(8, "sim2", "active", 20002, 20003)
    snapshot = Snapshot({7: robot, 8: other}, {(3, 7): granted, (3, 8): granted})
    return Access(
        replace(relay_settings(), tickets=TicketSettings("key", 30)),
        credentials or Credentials(database),
        lambda: snapshot,
        online_s,
        clock=lambda: datetime.fromtimestamp(time.time(), UTC),
    )


ANN, MAC = RelayUser(3, "ann"), "02:00:00:00:00:07"


@pytest.fixture
def database():
    return MemoryDatabase()


@pytest.fixture
def credentials(database):
    return Credentials(database)


@pytest.fixture
def login(database):
    return credential_of("login", database.add_credential("login", ANN))


def showing_ticket(login, name="sim1", mode="observe", *, remembered=False, mac=None):
    """A request with a ticket that web made of the database's answer, or of what it remembered."""
    robot = (None if remembered else 7, name)
    by = (mode, "login", login.digest.hex())
    ticket = Ticket(new_id(), ANN.id, ANN.name, *robot, *by, remembered=remembered, mac=mac)
    return Request("robots.example", None, TicketSigner("key", 30).sign(ticket), None, None)


@pytest.mark.parametrize(
    ("origin", "host", "passes"),
    [
        (None, "robots.example", True),
        ("https://robots.example", "robots.example:443", True),
        ("https://ROBOTS.example:8443", "robots.example:8443", True),
        ("http://localhost", "localhost", False),
        ("http://robots.example:443", "robots.example", False),
        ("HTTPS://robots.example", "robots.example", False),
        ("https://[::1]:8443", "[::1]:8443", True),
        ("https://lab.example", "robots.example", True),
        ("https://lab.example.evil", "robots.example", False),
        ("http://lab.example", "robots.example", False),
        ("https://robots.example:8443", "robots.example", False),
        ("https://robots.example.evil", "robots.example", False),
        ("https://robots.example@evil.example", "robots.example", False),
        ("https://evil.example/robots.example", "robots.example", False),
        ("https://robots.example/", "robots.example", False),
        ("null", "robots.example", False),
        ("", "", False),
        ("https://", "", False),
        ("ftp://robots.example", "robots.example", False),
        ("https://robots.example:x", "robots.example", False),
        ("https://[", "[", False),
    ],
)
def test_only_this_site_and_listed_origins_pass(origin, host, passes):
    access = access_of(MemoryDatabase())
    request = Request(host=host, origin=origin, ticket=None, login=None, authorization=None)
    if passes:
        access.check_origin(request)
    else:
        with pytest.raises(OriginRefusedError):
            access.check_origin(request)


@pytest.mark.parametrize(
    ("granted", "mode", "level", "may_drive"),
    [
        ("observe", "observe", "observe", False),
        ("manage", "observe", "observe", True),
        ("drive", "drive", "drive", True),
        ("manage", "drive", "manage", True),
    ],
)
async def test_a_ticket_to_observe_gives_no_more_rights_than_that(
    *, database, login, granted, mode, level, may_drive
):
    request = showing_ticket(login, mode=mode)
    permit = access_of(database, granted).for_rosbridge(request, "sim1")
    assert (permit.use, permit.level, permit.may_drive) == (mode, level, may_drive)


@pytest.mark.parametrize("opens", ["for_rosbridge", "for_video", "for_frames"])
async def test_a_ticket_from_webs_memory_needs_a_login_that_the_relay_knows(
    database, credentials, login, opens
):
    """One that the relay knows no more opens nothing."""
    access = access_of(database, credentials=credentials)

    async def open_by(**how):
        permit = getattr(access, opens)(showing_ticket(login, **how), "sim1")
        return permit if isinstance(permit, Permit) else await permit

    assert (await open_by(remembered=False)).credential == login
    with pytest.raises(StoreUnavailableError):
        await open_by(remembered=True)
    assert await credentials.holds(login)
    for mac in (None, MAC):
        assert (await open_by(remembered=True, mac=mac)).credential == login
    with pytest.raises(TicketForeignError):
        await open_by(remembered=True, mac="02:00:00:00:00:08")
    database.credentials.clear()
    await credentials.recheck()
    with pytest.raises(StoreUnavailableError):
        await open_by(remembered=True)


@pytest.mark.parametrize("remembered", [False, True])
@pytest.mark.parametrize(
    ("name", "asked_for", "mode", "problem"),
    [
        ("sim1", "sim1", "drive", GrantMissingError),
        ("sim2", "sim1", "observe", TicketForeignError),
        ("sim3", "sim3", "observe", RobotUnknownError),
    ],
)
async def test_a_ticket_opens_its_robot_within_the_grant(
    *, database, credentials, login, name, asked_for, mode, problem, remembered
):
    """Of one from its memory web knew neither; the robot is the one of its name."""
    access = access_of(database, credentials=credentials)
    assert await credentials.holds(login)
    with pytest.raises(problem):
        access.for_rosbridge(showing_ticket(login, asked_for, mode, remembered=remembered), name)


async def test_a_ticket_that_web_asked_the_database_for_makes_its_login_known(
    database, credentials, login
):
    """It does if the database has not answered the relay since."""
    access, request = access_of(database, credentials=credentials), showing_ticket(login)
    await credentials.check_new()
    await access.for_video(request, "sim1")
    assert not credentials.held_lately(login)
    credentials._answered_at -= 10
    await access.for_video(request, "sim1")
    assert credentials.held_lately(login)


@pytest.mark.parametrize(
    ("length", "is_asked_for"), [(0, False), (1, True), (512, True), (513, False)]
)
async def test_only_what_can_be_a_credential_is_looked_up(length, is_asked_for):
    """What is empty or too long costs neither a digest nor the database's time."""
    database = MemoryDatabase()
    access, text = access_of(database), "x" * length
    with pytest.raises(LoginMissingError):
        await access.asker(Request("robots.example", None, None, text, authorization=None))
    with pytest.raises(TokenInvalidError):
        await access.asker(Request("robots.example", None, None, None, f"Bearer {text}"))
    assert database.lookups == 2 * is_asked_for


def test_a_ticket_is_used_once():
    """However old it is: a clock that is set back makes it good again."""
    used = UsedTickets(START)
    used.use("a", later(0))
    used.use("b", later(90))
    with pytest.raises(TicketUsedError):
        used.use("a", later(0))


@pytest.mark.parametrize("remembered", [False, True])
@pytest.mark.parametrize(
    ("online_s", "is_good"), [(None, True), (15, True), (10.1, True), (9.5, False), (0, False)]
)
async def test_tickets_of_before_the_robot_came_are_refused(
    *, database, credentials, login, monkeypatch, online_s, is_good, remembered
):
    """This one is signed at 0 and shown at 10.6 s. Another cell may have used it; signatures have whole seconds."""
    now = START.timestamp()
    monkeypatch.setattr(time, "time", lambda: now)
    assert await credentials.holds(login)
    online = {7: online_s}.get
    access = access_of(database, "drive", credentials, online_s=online)
    request = showing_ticket(login, mode="drive", remembered=remembered)
    monkeypatch.setattr(time, "time", lambda: now + 10.6)
    if is_good:
        access.for_rosbridge(request, "sim1")
        return
    with pytest.raises(TicketExpiredError, match="connected elsewhere"):
        access.for_rosbridge(request, "sim1")


def test_a_full_memory_forgets_no_ticket_that_could_be_used_again():
    used = UsedTickets(START, capacity=2)
    for second, ticket_id in enumerate(["a", "b", "c"]):
        used.use(ticket_id, later(second))
    with pytest.raises(TicketExpiredError):
        used.refuse_too_old(later(0), later(3))
    used.refuse_too_old(later(1), later(3))
    with pytest.raises(TicketUsedError):
        used.use("b", later(1))


def test_tickets_of_before_the_start_are_refused():
    """A former relay may have seen them; a clock that is set back makes no new ticket too old."""
    used = UsedTickets(later(7200.7))
    for now in (later(7200.8), later(0.3), later(6)):
        with pytest.raises(TicketExpiredError):
            used.refuse_too_old(later(-1), now)
    used.refuse_too_old(later(5), later(6))
    UsedTickets(later(0.7)).refuse_too_old(later(0), later(0.8))

"""Origins and used tickets, without a network; the rest of access is tested through the handlers."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest
from relay_server import MemoryDatabase, utc
from robotether_server.db.fleet import RelayRobot, Snapshot
from robotether_server.problems import OriginRefused, TicketExpired, TicketUsed
from robotether_server.relay.auth.access import Access, Request, UsedTickets
from robotether_server.relay.auth.credentials import Credentials
from robotether_server.tickets import Ticket, TicketSigner, new_id

START = utc(2026, 1, 1, 12, 0)


def later(seconds: float):
    return START + timedelta(seconds=seconds)


@pytest.mark.parametrize(
    ("origin", "host", "passes"),
    [
        (None, "robots.example", True),
        ("https://robots.example", "robots.example", True),
        ("https://robots.example", "robots.example:443", True),
        ("https://ROBOTS.example:8443", "robots.example:8443", True),
        ("https://localhost", "localhost", True),
        ("http://localhost", "localhost", False),
        ("http://robots.example", "robots.example", False),
        ("http://robots.example:443", "robots.example", False),
        ("HTTPS://robots.example", "robots.example", False),
        ("https://[::1]:8443", "[::1]:8443", True),
        ("https://lab.example", "robots.example", True),
        ("https://lab.example.evil", "robots.example", False),
        ("http://lab.example", "robots.example", False),
        ("https://robots.example:8443", "robots.example", False),
        ("https://evil.example", "robots.example", False),
        ("https://robots.example.evil", "robots.example", False),
        ("https://robots.example@evil.example", "robots.example", False),
        ("https://evil.example/robots.example", "robots.example", False),
        ("https://robots.example/", "robots.example", False),
        ("null", "robots.example", False),
        ("", "robots.example", False),
        ("", "", False),
        ("https://", "", False),
        ("ftp://robots.example", "robots.example", False),
        ("https://robots.example:x", "robots.example", False),
        ("https://[", "[", False),
    ],
)
def test_only_this_site_and_listed_origins_pass(origin, host, passes):
    """An Origin must be absent, listed, or the host that was asked."""
    access = Access(
        signer=TicketSigner("key", 30),
        credentials=Credentials(MemoryDatabase()),
        snapshot=lambda: Snapshot({}, {}),
        allowed_origins=["https://lab.example"],
        clock=lambda: START,
    )
    request = Request(host=host, origin=origin, ticket=None, login=None, authorization=None)
    if passes:
        access.check_origin(request)
    else:
        with pytest.raises(OriginRefused):
            access.check_origin(request)


@pytest.mark.parametrize(
    ("granted", "mode", "level", "may_drive"),
    [
        ("observe", "observe", "observe", False),
        ("drive", "observe", "observe", True),
        ("manage", "observe", "observe", True),
        ("drive", "drive", "drive", True),
        ("manage", "drive", "manage", True),
    ],
)
def test_a_ticket_to_observe_gives_no_more_rights_than_that(granted, mode, level, may_drive):
    """Only a connection that drives has what its user was granted."""
    signer, robot = TicketSigner("key", 30), RelayRobot(7, "sim1", "active", 20000, 20001)
    access = Access(
        signer=signer,
        credentials=Credentials(MemoryDatabase()),
        snapshot=lambda: Snapshot({7: robot}, {(3, 7): granted}),
        allowed_origins=[],
        clock=lambda: datetime.now(UTC),
    )
    ticket = signer.sign(Ticket(new_id(), 3, "ann", 7, "sim1", mode, "login", "0f" * 32))
    request = Request("robots.example", origin=None, ticket=ticket, login=None, authorization=None)
    permit = access.for_rosbridge(request, "sim1")
    assert (permit.use, permit.level, permit.may_drive) == (mode, level, may_drive)


def test_a_ticket_is_used_once_as_long_as_it_is_good():
    """The id is known until the ticket itself has expired, to the second."""
    used = UsedTickets(START, ttl_s=30)
    used.use("a", later(0), later(0))
    with pytest.raises(TicketUsed):
        used.use("a", later(0), later(30.9))
    used.use("a", later(0), later(31.1))


def test_tickets_of_before_the_start_are_refused():
    """A former relay may have seen them."""
    used = UsedTickets(later(0.7), ttl_s=30)
    with pytest.raises(TicketExpired):
        used.refuse_too_old(later(-1))
    used.refuse_too_old(later(0))


def test_a_full_memory_forgets_no_ticket_that_could_be_used_again():
    """What is pushed out of the bounded memory is refused from then on by its age."""
    used = UsedTickets(START, ttl_s=30, capacity=2)
    for second, ticket_id in enumerate(["a", "b", "c"]):
        used.use(ticket_id, later(second), later(second))
    with pytest.raises(TicketExpired):
        used.refuse_too_old(later(0))
    used.refuse_too_old(later(1))
    with pytest.raises(TicketUsed):
        used.use("b", later(1), later(3))

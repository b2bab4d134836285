"""Tickets: what web signs the relay can verify, and nothing else."""

import datetime as dt
import time
from dataclasses import asdict, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from itsdangerous import URLSafeTimedSerializer
from robotether_server.problems import (
    TicketError,
    TicketExpiredError,
    TicketForgedError,
    TicketMalformedError,
)
from robotether_server.tickets import SALT, Ticket, TicketSigner, new_id

KEY = "k" * 32
SIGNER = TicketSigner(KEY, 30)
TICKET = Ticket(new_id(), 3, "ann", 7, "sim1", "drive", "login", "0f" * 32)


def sign_as_contract_says(fields):
    return str(URLSafeTimedSerializer(KEY, salt=SALT).dumps(fields))


def test_ticket_comes_back_with_its_moment():
    """docs/reference/protocols.md and this class name the same serializer, salt and fields."""
    ticket, issued_at = SIGNER.verify(sign_as_contract_says(asdict(TICKET)))
    assert ticket == TICKET
    assert abs(dt.datetime.now(dt.UTC) - issued_at) < dt.timedelta(seconds=3)


def test_ticket_from_memory_says_so_and_no_other_does():
    """A relay that does not know the word accepts tickets as before, and none from memory."""
    remembered = replace(TICKET, robot_id=None, remembered=True, mac="00:1b:44:11:3a:b7")
    assert SIGNER.verify(SIGNER.sign(remembered))[0] == remembered
    fields = URLSafeTimedSerializer(KEY, salt=SALT).loads(SIGNER.sign(TICKET))
    assert fields.keys() == Ticket.__dataclass_fields__.keys() - {"remembered", "mac"}


@pytest.mark.parametrize(("later_s", "is_good"), [(-3, False), (-2, True), (30, True), (31, False)])
def test_ticket_is_good_for_its_time(monkeypatch, later_s, is_good):
    now = int(time.time())
    monkeypatch.setattr(time, "time", lambda: now)
    text = SIGNER.sign(TICKET)
    monkeypatch.setattr(time, "time", lambda: now + later_s)
    if is_good:
        assert SIGNER.verify(text)[0] == TICKET
    else:
        with pytest.raises(TicketExpiredError):
            SIGNER.verify(text)


@pytest.mark.parametrize(
    "text",
    [
        TicketSigner("x" * 32, 30).sign(TICKET),
        SIGNER.sign(TICKET)[:-2],
        SIGNER.sign(TICKET) + "é",
        SIGNER.sign(TICKET) + "\udce9",
        "e30" + SIGNER.sign(TICKET)[3:],
        TicketSigner("x" * 32, 30).sign(replace(TICKET, user="a" * 500)),
    ],
    ids=["foreign key", "cut", "with more", "not Unicode", "changed", "compressed"],
)
def test_ticket_of_another_hand_is_forged(text):
    """A signature that is not ours is told from a text that is no ticket."""
    with pytest.raises(TicketForgedError):
        SIGNER.verify(text)


@pytest.mark.parametrize(
    "fields",
    [
        [],
        asdict(TICKET) | {"mode": "fly"},
        asdict(TICKET) | {"user_id": "3"},
        asdict(TICKET) | {"robot_id": True},
        asdict(TICKET) | {"robot": None},
        asdict(TICKET) | {"more": 1},
        asdict(TICKET) | {"remembered": "yes"},
        asdict(TICKET) | {"credential": "key"},
        asdict(TICKET) | {"credential_sha256": "0f" * 31},
        {name: value for name, value in asdict(TICKET).items() if name != "credential_sha256"},
    ],
)
def test_ticket_with_other_fields_is_malformed(fields):
    """Our own signature does not make a wrong field right."""
    with pytest.raises(TicketMalformedError):
        SIGNER.verify(sign_as_contract_says(fields))


@given(st.text(max_size=200))
def test_rubbish_is_refused_with_a_problem(text):
    with pytest.raises(TicketError):
        SIGNER.verify(text)

"""Problems: one tree, with codes that are each used once."""

from __future__ import annotations

import pytest
from robotether_server import problems
from robotether_server.problems import HttpProblem, Problem, TicketExpired


def codes(kind: type[Problem]) -> list[str]:
    """Every code below a class, as often as classes gave themselves one."""
    below = [child for child in kind.__subclasses__() if child.__module__ == problems.__name__]
    own = [child.code for child in below if child.code != kind.code]
    return [*own, *(code for child in below for code in codes(child))]


def test_codes_are_unique() -> None:
    """A code in a log leads to one class."""
    found = codes(Problem)
    assert len(found) == len(set(found)) > 1


def test_problem_is_rendered_as_in_the_contract() -> None:
    """The members are those of RFC 9457 and the code."""
    assert TicketExpired("cannot open it").as_dict() == {
        "type": "about:blank",
        "title": "Unauthorized",
        "status": 401,
        "code": "ticket_expired",
        "detail": "cannot open it",
    }


@pytest.mark.parametrize(
    ("status", "code"),
    [
        (404, "not_found"),
        (405, "method_not_allowed"),
        (413, "request_entity_too_large"),
        (414, "request_uri_too_long"),
        (416, "requested_range_not_satisfiable"),
        (422, "unprocessable_entity"),
        (500, "internal_server_error"),
    ],
)
def test_http_errors_have_codes_too(status: int, code: str) -> None:
    """What HTTP names, the code names alike."""
    assert HttpProblem(status, "x").as_dict()["code"] == code

"""Operators are as many users as the server wants, and pairs are told apart by their networks."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import pytest
from numbered_runs import a_run
from paper.numbered_run import PAIRS_A_USER, Generator, Pair, Plan, by_network, tokens
from paper.profiles import FIXED, SLOW_4G, Profile
from paper.robots import WholeRobot
from paper.uplinks import Uplink
from paper.world import World


class Site:
    """A double of the World: it notes what it is asked, and makes a token for each user."""

    token = "own"

    def __init__(self) -> None:
        self.asked: list[tuple[str, str]] = []

    def api(self, method: str, path: str, _body: object = None) -> None:
        """Any request."""
        self.asked.append((method, path.rpartition("/")[0] or path))

    def exec(self, _service: str, *command: str) -> str:
        """The admin's command; the token is the last word."""
        return f"the token is of-{command[command.index('--user') + 1]}\n"


def behind(profile: Profile) -> Pair:
    """A pair whose operator is there; no network is made."""
    return Pair(Uplink(profile, "198.51.100.1"), cast("WholeRobot", None))


def test_few_operators_are_one_user() -> None:
    """The world's own."""
    site = Site()
    with tokens(cast("World", site), PAIRS_A_USER) as given:
        assert given == ["own"] * PAIRS_A_USER
    assert site.asked == []


def test_more_operators_are_more_users_who_are_gone_afterwards() -> None:
    """No user has more connections than the relay lets one have."""
    site = Site()
    with tokens(cast("World", site), 2 * PAIRS_A_USER + 1) as given:
        assert [given.count(one) for one in dict.fromkeys(given)] == [PAIRS_A_USER, PAIRS_A_USER, 1]
        assert site.asked == [("POST", "/users")] * 2
    assert site.asked[2:] == [("DELETE", "/users")] * 2


def test_a_generator_that_ends_is_told_by_its_last_words(tmp_path: Path) -> None:
    """They stand in a table; where in the program it ended is for the log."""
    log = tmp_path / "log"
    generator = Generator([], log)
    try:
        with pytest.raises(RuntimeError) as told:
            generator.hear("that all are connected", 30)
    finally:
        generator.close()
    words = log.read_text()
    last = words.splitlines()[-1]
    assert "IndexError" in last
    assert str(told.value) == f"a load generator ended: that all are connected; {last}"
    assert told.value.__notes__ == [words[-2000:]]
    assert "Traceback" in words


def test_pairs_on_one_network_are_not_told_twice() -> None:
    """The run itself tells of them."""
    assert by_network([behind(FIXED)] * 2, Plan(count=1, rate_hz=1), [], []) == {}


def test_pairs_are_told_by_their_network() -> None:
    """Each with what its own senders and receivers saw."""
    usual = a_run()
    connections = ("redials", "endings", "failed_dials", "dial_failures")
    sender = {name: usual[name] for name in ("unsent", *connections, "lateness")}
    names = ("duplicated", "reordered", "foreign", *connections, "latency")
    receiver = {name: usual[name] for name in names}
    sent: list[dict[str, Any]] = [{**sender, "pair": pair, "sent": 5} for pair in range(3)]
    came: list[dict[str, Any]] = [
        {**receiver, "pair": pair, "received": 5 - pair, "missing": []} for pair in range(3)
    ]
    pairs = [behind(FIXED), behind(SLOW_4G), behind(FIXED)]
    found = by_network(pairs, Plan(count=5, rate_hz=100), sent, came)
    assert list(found) == [FIXED.name, SLOW_4G.name]
    assert (found[FIXED.name]["pairs"], found[FIXED.name]["lost"]) == (2, 2)
    assert (found[SLOW_4G.name]["sent"], found[SLOW_4G.name]["received"]) == (5, 4)

"""The pauses between tries, without a network."""

from __future__ import annotations

from itertools import islice

from robotether_server.relay.http.backoff import delays


def test_pauses_double_up_to_the_longest():
    """Half a second first, five at most, for ever."""
    assert list(islice(delays(), 7)) == [0.5, 1.0, 2.0, 4.0, 5.0, 5.0, 5.0]


def test_each_outage_begins_with_a_short_pause():
    """Two generators know nothing of each other."""
    worn = delays(first_s=0.1, max_s=1.0, factor=3.0)
    assert list(islice(worn, 4))[-1] == 1.0
    assert next(delays(first_s=0.1, max_s=1.0, factor=3.0)) == 0.1

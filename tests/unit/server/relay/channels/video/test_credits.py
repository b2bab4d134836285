"""How many frames a robot may have under way; the feed's own tests hold the rest of the books."""

import pytest
from robotether_server.relay.channels.video.credits import Credits


@pytest.mark.parametrize(
    ("way_s", "interval_s", "is_encoded", "expected"),
    [
        (0, 1 / 60, True, 2),
        (0.038, 1 / 25, True, 3),
        (0.038, 1 / 25, False, 2),
        (0.038, 1 / 15, True, 2),
        (0.28, 1 / 15, False, 6),
        (2.0, 1 / 60, True, 8),
    ],
)
def test_the_way_does_not_bound_the_rate(way_s, interval_s, is_encoded, expected):
    books, now_s = Credits(), 0.0
    under_way = books.grant(way_s)
    for sequence in range(80):
        now_s += interval_s
        books.on_frame(now_s, is_encoded=is_encoded)
        books.await_taken(sequence)
        assert books.on_taken(sequence)
        under_way += books.grant(way_s) - 1
    assert under_way == expected

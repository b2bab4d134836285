"""Going over from one source to the next: no gap, no picture twice, none out of order."""

from __future__ import annotations

import pytest
from fake_cameras import fake_jpeg
from robotether_agent.media.feeds import Condition, Feed
from robotether_agent.media.picture import Picture, Wish
from robotether_agent.media.switch import GIVE_UP_S, Switch

HIGH, LOW = (Wish("/camera", quality, None, None, 15.0) for quality in (80, 40))


class FakeFeed:
    """A feed without a source."""

    def __init__(self, wish: Wish) -> None:
        self.wish = wish
        self.followers = {}
        self.state = "live"

    def condition(self) -> Condition:
        return Condition(self.state)


class FakeFeeds:
    """Who follows what; a clock too."""

    def __init__(self) -> None:
        self.open: dict[Wish, FakeFeed] = {}
        self.now_s = 10.0

    def follow(self, wish, who, take):
        feed = self.open.setdefault(wish, FakeFeed(wish))
        feed.followers[who] = take
        return feed

    def leave(self, feed: Feed, who: object) -> None:
        feed.followers.pop(who, None)
        if not feed.followers:
            self.open.pop(feed.wish, None)

    def give(self, wish: Wish, moment_s: float) -> None:
        picture = Picture(fake_jpeg(int(moment_s * 1000)), moment_s, self.now_s)
        for take in tuple(self.open[wish].followers.values()):
            take(picture)


@pytest.fixture
def feeds() -> FakeFeeds:
    """No real source is needed for the order of pictures."""
    return FakeFeeds()


@pytest.fixture
def got() -> list[tuple[float, int]]:
    """Moment and quality of what went on."""
    return []


@pytest.fixture
def switch(feeds, got) -> Switch:
    """What follows them."""
    return Switch(
        feeds, lambda p, w: got.append((round(p.moment_s, 3), w.quality)), lambda: feeds.now_s
    )


def test_the_new_source_is_open_before_the_old_one_ends(feeds, switch, got):
    """Pictures go on from the old one until the new one has a newer one."""
    switch.follow(HIGH)
    for n in range(10):
        feeds.give(HIGH, n * 0.066)
    switch.follow(LOW)
    assert set(feeds.open) == {HIGH, LOW}
    feeds.give(HIGH, 0.66)
    # The same picture at another quality, some ms later as the server's own stamp tells.
    feeds.give(LOW, 0.668)
    assert (switch.wish, set(feeds.open)) == (LOW, {LOW})
    feeds.give(LOW, 0.726)
    assert [quality for _, quality in got] == [80] * 11 + [40]
    moments = [moment for moment, _ in got]
    assert moments == sorted(set(moments))


def test_a_new_source_that_is_first_with_a_picture(feeds, switch, got):
    switch.follow(HIGH)
    feeds.give(HIGH, 1.0)
    switch.follow(LOW)
    feeds.give(LOW, 1.066)
    assert got == [(1.0, 80), (1.066, 40)]
    assert set(feeds.open) == {LOW}


def test_an_older_picture_does_not_go_on(feeds, switch, got):
    switch.follow(HIGH)
    feeds.give(HIGH, 5.0)
    feeds.give(HIGH, 4.9)
    assert got == [(5.0, 80)]


def test_a_wish_that_changes_meanwhile(feeds, switch):
    """The newest counts, and going back opens nothing."""
    other = Wish("/camera", 20, None, None, 15.0)
    switch.follow(HIGH)
    feeds.give(HIGH, 1.0)
    switch.follow(LOW)
    switch.follow(other)
    assert set(feeds.open) == {HIGH, other}
    switch.follow(HIGH)
    assert set(feeds.open) == {HIGH}


def test_a_new_source_that_gives_nothing_is_let_go(feeds, switch):
    switch.follow(HIGH)
    feeds.give(HIGH, 1.0)
    switch.follow(LOW)
    assert not switch.give_up_late()
    feeds.now_s += GIVE_UP_S
    assert switch.give_up_late()
    assert (switch.wish, set(feeds.open)) == (HIGH, {HIGH})


def test_when_neither_gives_anything_the_newer_wish_counts(feeds, switch):
    """So that what is wanted is asked for when the camera comes back."""
    switch.follow(HIGH)
    feeds.open[HIGH].state = "down"
    switch.follow(LOW)
    feeds.now_s += GIVE_UP_S
    assert not switch.give_up_late()
    assert (switch.wish, set(feeds.open)) == (LOW, {LOW})


def test_leaving_closes_both(feeds, switch):
    """Also in the middle of a change; following begins anew."""
    switch.follow(HIGH)
    switch.follow(LOW)
    switch.leave()
    assert (feeds.open, switch.wish, switch.condition()) == ({}, None, Condition())
    switch.follow(LOW)
    assert switch.wish == LOW

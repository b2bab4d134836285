"""How subscriptions are counted."""

from __future__ import annotations

from robotether_server.relay.rosbridge.subscriptions import Subscriptions


def test_each_id_of_a_topic_counts_once():
    """The same subscription again changes nothing, also when there is room for no more."""
    mine = Subscriptions(2)
    assert [mine.add("/a", 1), mine.add("/a", 1), mine.add("/a", None)] == [True, True, True]
    assert [mine.add("/b", 1), mine.add("/a", 2), mine.add("/a", 1)] == [False, False, True]
    assert len(mine) == 2


def test_one_is_given_up_by_its_id():
    """Only that one makes room."""
    mine = Subscriptions(2)
    mine.add("/a", 1)
    mine.add("/a", 2)
    mine.remove("/a", 1)
    assert len(mine) == 1
    assert mine.add("/b", 1)
    assert not mine.add("/a", 1)


def test_without_an_id_all_of_the_topic_go():
    """As rosbridge does it."""
    mine = Subscriptions(3)
    for subscription in (("/a", 1), ("/a", None), ("/b", 1)):
        mine.add(*subscription)
    mine.remove("/a", None)
    assert len(mine) == 1


def test_giving_up_what_there_is_not_changes_nothing():
    """Neither the count nor what is kept."""
    mine = Subscriptions(1)
    mine.remove("/a", None)
    mine.remove("/a", 1)
    mine.add("/a", 1)
    mine.remove("/a", 2)
    mine.remove("/b", 1)
    assert len(mine) == 1

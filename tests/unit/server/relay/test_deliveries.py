"""The counts of pictures that users got."""

from robotether_server.relay.deliveries import NOTHING, Delivered, Deliveries


class _Clock:
    """A clock that a test turns."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_counts_each_users_pictures_of_each_robot_by_themselves() -> None:
    """What one user got of one robot counts for nobody else and for no other robot."""
    deliveries = Deliveries()
    deliveries.count(7, 3, 1000)
    deliveries.count(7, 3, 500)
    deliveries.count(7, 4, 200)
    assert deliveries.of(7, 3) == Delivered(pictures=2, bytes=1500)
    assert deliveries.of(7, 4) == Delivered(pictures=1, bytes=200)
    assert deliveries.of(8, 3) == NOTHING


def test_tells_what_came_since_an_earlier_count() -> None:
    """A drive's pictures and seconds are those between its beginning and its end."""
    clock = _Clock()
    deliveries = Deliveries(clock)
    deliveries.count(7, 3, 1000)
    with deliveries.viewing(7, 3):
        clock.now += 2
        begun = deliveries.of(7, 3)
        deliveries.count(7, 3, 400)
        clock.now += 3
        since = deliveries.of(7, 3).since(begun)
    assert since == Delivered(pictures=1, bytes=400, viewed_s=3.0)


def test_two_cameras_at_once_are_watched_for_one_time() -> None:
    """Time counts while at least one video is open, and no longer."""
    clock = _Clock()
    deliveries = Deliveries(clock)
    with deliveries.viewing(7, 3):
        clock.now += 1
        with deliveries.viewing(7, 3):
            clock.now += 4
        clock.now += 1
    clock.now += 50
    with deliveries.viewing(7, 3):
        clock.now += 2
    assert deliveries.of(7, 3).viewed_s == 8.0
    assert deliveries.of(7, 4).viewed_s == 0.0

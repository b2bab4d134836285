"""The counts of pictures that users got."""

from robotether_server.relay.deliveries import NOTHING, Deliveries, Delivered


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
    """A drive's pictures are those between its beginning and its end."""
    deliveries = Deliveries()
    deliveries.count(7, 3, 1000)
    begun = deliveries.of(7, 3)
    deliveries.count(7, 3, 400)
    assert deliveries.of(7, 3).since(begun) == Delivered(pictures=1, bytes=400)

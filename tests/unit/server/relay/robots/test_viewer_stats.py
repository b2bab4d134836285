"""The counts of frames that users got."""

from robotether_server.relay.robots.drive_log import ViewerStats
from validators import Clock


def test_two_cameras_at_once_are_watched_for_one_time():
    clock = Clock()
    viewer_stats = ViewerStats(clock)
    with viewer_stats.viewing(3):
        clock.now += 1
        with viewer_stats.viewing(3):
            clock.now += 4
        clock.now += 1
    clock.now += 50
    with viewer_stats.viewing(3):
        clock.now += 2
    assert viewer_stats.of(3).viewed_s == 8.0
    assert viewer_stats.of(4).viewed_s == 0.0

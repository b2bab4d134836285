"""Which of several robots on one ROS graph has which topics."""

import json
from pathlib import Path

import pytest
from robotether_common.own_topics import own_topic, own_topics, same_type
from robotether_common.ros import camera_topics

# Which the page's test reads too.
GRAPHS = json.loads(
    (Path(__file__).parents[3] / "server/frontend/test/topics/ros_graphs.json").read_text()
)


@pytest.mark.parametrize("case", GRAPHS, ids=lambda case: case["why"])
def test_of_one_graph_all_choose_the_same(case):
    topics = {name: same_type(kind) for name, kind in case["topics"].items()}
    own = own_topics(topics, case["drive_topic"])
    assert sorted(own) == case["own"]
    odometry = own_topic(topics, "nav_msgs/Odometry", ("odom",), case["drive_topic"])
    assert odometry == case["odometry"]
    assert camera_topics(own) == case["cameras"]

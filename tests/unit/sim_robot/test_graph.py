"""A graph begins empty, in one ROS version."""

from sim_robot.graph import make_graph


def test_new_graph_is_empty() -> None:
    """No topics, no services, the types of the version."""
    graph = make_graph(1)
    assert graph.bus.topics() == {}
    assert graph.services.all() == []
    assert graph.types.ros_version == 1

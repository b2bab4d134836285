"""rosapi tells what there is."""

import time
from typing import Any

import pytest
from sim_client import DirectClient
from sim_robot.graph import make_graph
from sim_robot.robot import Robot


async def call(client: DirectClient, name: str, **args: Any) -> dict[str, Any]:
    """Call one of rosapi's services that must succeed."""
    (answer,) = await client.send(op="call_service", service=f"/rosapi/{name}", args=args)
    assert answer["result"] is True, answer
    return answer["values"]


@pytest.fixture
async def robot() -> DirectClient:
    """A client of a ROS 2 robot."""
    graph = make_graph(2)
    Robot(graph, 20.0)
    return DirectClient(graph)


async def test_topics_and_types(robot: DirectClient) -> None:
    """The service topics lists names with types in the same order."""
    values = await call(robot, "topics")
    assert dict(zip(values["topics"], values["types"], strict=True)) == {
        "/cmd_vel": "geometry_msgs/msg/Twist",
        "/odom": "nav_msgs/msg/Odometry",
        "/pose": "turtlesim/msg/Pose",
    }


async def test_type_of_topic(robot: DirectClient) -> None:
    """topic_type is empty for a topic that does not exist."""
    assert await call(robot, "topic_type", topic="/odom") == {"type": "nav_msgs/msg/Odometry"}
    assert await call(robot, "topic_type", topic="/nope") == {"type": ""}


async def test_topics_for_type(robot: DirectClient) -> None:
    """Both spellings find the topic, an unknown type finds none."""
    for name in ("geometry_msgs/Twist", "geometry_msgs/msg/Twist"):
        assert await call(robot, "topics_for_type", type=name) == {"topics": ["/cmd_vel"]}
    assert await call(robot, "topics_for_type", type="no/Type") == {"topics": []}


async def test_who_publishes_and_listens(robot: DirectClient) -> None:
    """publishers, subscribers and node_details agree; clients appear as rosbridge."""
    await robot.send(op="subscribe", topic="/pose")
    assert await call(robot, "publishers", topic="/pose") == {"publishers": ["/sim_robot"]}
    assert await call(robot, "subscribers", topic="/pose") == {
        "subscribers": ["/rosbridge_websocket"]
    }
    details = await call(robot, "node_details", node="/sim_robot")
    assert details == {
        "subscribing": ["/cmd_vel"],
        "publishing": ["/odom", "/pose"],
        "services": ["/reset"],
    }


async def test_nodes(robot: DirectClient) -> None:
    """All nodes are listed once."""
    assert await call(robot, "nodes") == {"nodes": ["/rosapi", "/sim_robot"]}


async def test_services(robot: DirectClient) -> None:
    """services, service_type and services_for_type agree."""
    assert "/reset" in (await call(robot, "services"))["services"]
    assert await call(robot, "service_type", service="/reset") == {"type": "std_srvs/srv/Empty"}
    assert await call(robot, "service_type", service="/nope") == {"type": ""}
    assert await call(robot, "services_for_type", type="std_srvs/srv/Empty") == {
        "services": ["/reset"]
    }


@pytest.mark.parametrize(("version", "seconds"), [(1, "secs"), (2, "sec")])
async def test_time_and_version(version: int, seconds: str) -> None:
    """get_time speaks the words of the ROS version, get_ros_version names it."""
    client = DirectClient(make_graph(version))
    assert abs((await call(client, "get_time"))["time"][seconds] - time.time()) < 2
    assert (await call(client, "get_ros_version"))["version"] == version


async def test_ros_1_writes_short_types() -> None:
    """A ROS 1 robot says geometry_msgs/Twist."""
    graph = make_graph(1)
    Robot(graph, 20.0)
    assert await call(DirectClient(graph), "topic_type", topic="/cmd_vel") == {
        "type": "geometry_msgs/Twist"
    }


async def test_args_are_checked(robot: DirectClient) -> None:
    """An argument that the service lacks is an error response."""
    (answer,) = await robot.send(
        op="call_service", service="/rosapi/topic_type", args={"name": "/odom"}
    )
    assert answer["result"] is False
    assert "has no field name" in answer["values"]

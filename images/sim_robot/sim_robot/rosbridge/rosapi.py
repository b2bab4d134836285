"""The services under /rosapi that tell a client what there is on the robot.

Those of the real rosapi that agent, relay, recorder and pages use.
"""

import time
from collections.abc import Callable
from functools import partial

from sim_robot.graph import Graph, Service
from sim_robot.messages import ROS_1, ROS_2, Fields, TypeUnknownError, Values

NODE = "/rosapi"
# The last of each that takes a Twist.
DISTROS = {ROS_1: "noetic", ROS_2: "iron"}
_NOTHING: Fields = ()
_TOPIC: Fields = (("topic", "string"),)
_TYPE: Fields = (("type", "string"),)

Answer = Callable[[Graph, Values], Values]


def offer(graph: Graph) -> None:
    """Add all of them to the graph."""
    package = "rosapi" if graph.types.ros_version == ROS_1 else "rosapi_msgs"
    for name, key, request, answer in _SERVICES:
        handler = partial(answer, graph)
        service = Service(f"{NODE}/{name}", f"{package}/{key}", NODE, request, handler)
        graph.services.add(service)


def _topics(graph: Graph, _request: Values) -> Values:
    topics = graph.bus.topics()
    return {"topics": list(topics), "types": [graph.types.name_of(key) for key in topics.values()]}


def _topic_type(graph: Graph, request: Values) -> Values:
    key = graph.bus.type_key(request["topic"])
    return {"type": graph.types.name_of(key) if key else ""}


def _publishers(graph: Graph, request: Values) -> Values:
    return {"publishers": graph.bus.publisher_names(request["topic"])}


def _subscribers(graph: Graph, request: Values) -> Values:
    return {"subscribers": graph.bus.subscriber_names(request["topic"])}


def _message_details(graph: Graph, request: Values) -> Values:
    """Describe a type, and each type in it, as the real one does."""
    try:
        waiting = [graph.types.key_of(request["type"])]
    except TypeUnknownError:
        return {"typedefs": []}
    typedefs: dict[str, Values] = {}
    while waiting:
        key = waiting.pop()
        if key not in typedefs:
            typedefs[key] = _typedef(graph, key)
            inner = typedefs[key]["fieldtypes"]
            waiting += [kind for kind in inner if graph.types.is_message(kind)]
    return {"typedefs": list(typedefs.values())}


def _typedef(graph: Graph, key: str) -> Values:
    fields = [(name, *_array(field_type)) for name, field_type in graph.types.fields(key)]
    return {
        "type": key,
        "fieldnames": [name for name, _, _ in fields],
        "fieldtypes": [kind for _, kind, _ in fields],
        "fieldarraylen": [length for _, _, length in fields],
        "examples": [],
        "constnames": [],
        "constvalues": [],
    }


def _array(field_type: str) -> tuple[str, int]:
    """Return the type of one item, and the length: -1 of what is not an array, 0 of any."""
    kind, bracket, length = field_type.removesuffix("]").partition("[")
    return kind, int(length or 0) if bracket else -1


def _get_time(graph: Graph, _request: Values) -> Values:
    return {"time": graph.types.time(time.time_ns())}


def _get_ros_version(graph: Graph, _request: Values) -> Values:
    version = graph.types.ros_version
    return {"version": version, "distro": DISTROS[version]}


_SERVICES: tuple[tuple[str, str, Fields, Answer], ...] = (
    ("topics", "Topics", _NOTHING, _topics),
    ("topic_type", "TopicType", _TOPIC, _topic_type),
    ("publishers", "Publishers", _TOPIC, _publishers),
    ("subscribers", "Subscribers", _TOPIC, _subscribers),
    ("message_details", "MessageDetails", _TYPE, _message_details),
    ("get_time", "GetTime", _NOTHING, _get_time),
    ("get_ros_version", "GetROSVersion", _NOTHING, _get_ros_version),
)

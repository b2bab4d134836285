"""What a robot's ROS offers over HTTP: the newest message of a topic, and calls of services."""

from typing import Annotated, Any

from msgspec import UNSET, Meta, Raw, Struct, UnsetType

from robotether_server.contract.control import RobotQuery

# Part of each refusal by the robot's policy, which lasts as long as the connection.
POLICY_REFUSES = "the robot's policy does not let you"
MAX_WAIT_S = 30
USUAL_WAIT_S = 5
MAX_THROTTLE_MS = 3_600_000
# Maximum size of a service's request.
MAX_ARGS_BYTES = 64 * 1024

RosType = Annotated[
    str,
    Meta(
        min_length=1,
        max_length=1024,
        description="The ROS type; without it rosbridge finds it",
        extra_json_schema={"examples": ["nav_msgs/msg/Odometry"]},
    ),
]
Seconds = Annotated[int, Meta(le=MAX_WAIT_S, extra_json_schema={"default": USUAL_WAIT_S})]


class TopicQuery(RobotQuery, frozen=True):
    """Which messages, and for how long to wait for one."""

    type: RosType | UnsetType = UNSET
    throttle_rate: (
        Annotated[
            int,
            Meta(
                ge=0,
                le=MAX_THROTTLE_MS,
                description="Minimum interval between messages from the robot, in ms",
            ),
        ]
        | UnsetType
    ) = UNSET
    wait_s: Annotated[Seconds, Meta(ge=0, description="Time limit for a message")] = USUAL_WAIT_S
    since: (
        Annotated[
            str,
            Meta(
                min_length=1,
                max_length=64,
                description="`sequence` of an earlier answer: only a newer message",
            ),
        ]
        | UnsetType
    ) = UNSET


class TopicAnswer(Struct, frozen=True):
    """The newest message. `received_age_s`: since when the server has it, by the server's clock alone.

    A latched message, or one on a slow line, is older than that. Its own stamp is of another clock.
    """

    topic: str
    received_age_s: Annotated[float, Meta(ge=0)]
    sequence: str
    message: Annotated[Raw, Meta(extra_json_schema={"type": "object"})]


class ServiceQuery(RobotQuery, frozen=True):
    """The service's type, and for how long to wait for its answer."""

    type: RosType | UnsetType = UNSET
    timeout_s: Annotated[Seconds, Meta(ge=1, description="Time limit for the answer")] = (
        USUAL_WAIT_S
    )


class ServiceAnswer(Struct, frozen=True, omit_defaults=True):
    """rosbridge's answer: `values`, or with `result` false the `reason`."""

    result: bool
    values: Annotated[Raw, Meta(extra_json_schema={"type": "object"})] | UnsetType = UNSET
    reason: str | UnsetType = UNSET


# Of a service's request, as rosbridge's `args`.
ServiceArgs = dict[str, Any]

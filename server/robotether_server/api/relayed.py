"""What the relay answers under /api/v1 (relay/control/control_api.py, relay/channels): nginx leads it there.

Described here, as one API has one description; nothing of it is handled here.
"""

from typing import Any

from robotether_server.api.operations import ApiOperation
from robotether_server.contract.control import (
    ControlObject,
    LeaseAction,
    ShownStop,
    SiteStop,
    StoppedRobotList,
    StopQuery,
    StopReason,
)
from robotether_server.contract.robots import EVENTS
from robotether_server.contract.ros import (
    ServiceAnswer,
    ServiceArgs,
    ServiceQuery,
    TopicAnswer,
    TopicQuery,
)
from robotether_server.contract.routes import LiveRouteList
from robotether_server.contract.uplink import UplinkObject

CONTROL: dict[int, Any] = {200: ControlObject}

RELAYED = (
    ApiOperation(
        method="GET",
        path="/events",
        name="events",
        summary="Follow the fleet, live",
        details="Server-sent events without an end, of the robots that the caller may see: `fleet` with all of them, "
        "then `robot` at each change of one, and `removed`. After 3 s without an event a comment. A user may have 32 "
        "at once.",
        who="user",
        answers={200: None},
        events=EVENTS,
    ),
    ApiOperation(
        method="GET",
        path="/robots/<robot>/control",
        name="showControl",
        summary="Get the control object: who drives, who asks, who stopped the robot",
        who="user",
        tag="control",
        answers=CONTROL,
    ),
    ApiOperation(
        method="GET",
        path="/robots/<robot>/uplink",
        name="showUplink",
        summary="Get what fills the robot's uplink: cameras, topics, and the rest that passes the server",
        details="Takes 1 s when nobody has asked lately. Shells, heartbeats, published ports and what SSH adds are not "
        "measured. 503 robot_offline: the robot is at no machine of the site.",
        who="user",
        tag="control",
        answers={200: UplinkObject},
        problems=(503,),
    ),
    ApiOperation(
        method="POST",
        path="/robots/<robot>/lease",
        name="changeLease",
        summary="Ask for control, answer a request for it, or take it",
        details="`ask` while another user drives, and `withdraw`: level drive. `hand_over`, `refuse`: the driver. "
        "`take`: level manage; it ends a lease or reservation at once, with `driver` only that user's lease. "
        "Control passes on when the driver leaves, hands over, or neither replies nor publishes to a drive topic for "
        "20 s; it is then reserved for the new user's drive connection for 10 s. After three requests in a row a user "
        "may send one every 30 s, until they get control; others are 429 throttled, with Retry-After. Repeating one "
        "that waits does not count.",
        who="user",
        tag="control",
        body=LeaseAction,
        answers=CONTROL,
        problems=(400, 409),
    ),
    ApiOperation(
        method="POST",
        path="/robots/<robot>/stop",
        name="stopRobot",
        summary="Stop the robot; for everybody who may see it",
        details="It goes to the robot first, ends the lease, and holds until a driver releases it. An offline robot is "
        "stopped when it returns. The answer waits up to 1 s for `confirmed`: the guard has the stop on disk, or its "
        "disk failed and the robot is stopped. Another user's stop replaces an earlier one; the same user's within 1 s "
        "does not. A body that cannot be read is no reason, and refuses no stop. This is not a safety-rated emergency "
        "stop.",
        who="user",
        tag="control",
        query=StopQuery,
        body=StopReason,
        is_body_required=False,
        answers=CONTROL,
    ),
    ApiOperation(
        method="POST",
        path="/robots/<robot>/release",
        name="releaseRobot",
        summary="Release a stopped robot; level drive",
        details="Ends all stops of the robot if the guard confirms it within 2 s; else the robot stays stopped. 409 "
        "not_possible: it was stopped again, or the newest stop is not the one that `by` and `at` name, as the control "
        "object shows them. Without a guard (`off`, `unknown`) it is the server's alone, as a stop is, unconfirmed.",
        who="user",
        tag="control",
        body=ShownStop,
        is_body_required=False,
        answers=CONTROL,
        problems=(400, 409, 504),
    ),
    ApiOperation(
        method="POST",
        path="/stop",
        name="stopAll",
        summary="Stop all robots, or those of a site, that the caller manages",
        who="user",
        tag="control",
        body=SiteStop,
        is_body_required=False,
        answers={200: StoppedRobotList},
        problems=(400,),
    ),
    ApiOperation(
        method="GET",
        path="/routes/live",
        name="liveRoutes",
        summary="Get the routes that last as they are now: whether they run, and their rates; and your web apps",
        who="user",
        answers={200: LiveRouteList},
    ),
    ApiOperation(
        method="GET",
        path="/robots/<robot>/topics/<topic>",
        name="readTopic",
        summary="Get the newest message of a topic",
        details="What an observing connection may subscribe to. 204: none came within `wait_s`, or none but that of "
        "`since`. Programs that poll within 5 s share one subscription on the robot; after a longer pause a latched "
        "message comes again, with a new `sequence`. 502 topic_down says why a topic brings nothing.",
        who="user",
        tag="ros",
        query=TopicQuery,
        answers={200: TopicAnswer, 204: None},
        problems=(403, 502),
    ),
    ApiOperation(
        method="POST",
        path="/robots/<robot>/services/<service>",
        name="callService",
        summary="Call a service of the robot's ROS; the body has the members of its request",
        details="What the robot's policy lets the user call. Beyond rosapi's look-ups it needs level drive and the "
        "lease: that of the user's own drive, or one that lasts for the call and that the user's other calls share. "
        "Else 409: lease_held, robot_stopped, lease_lost, or superseded (a page of the same user drives). A stop, or "
        "any other end, does not end what the robot runs: `detail` says whether the service may still run, unless the "
        "answer is 503 service_away, after which it may. The audit log has these calls.",
        who="user",
        tag="ros",
        body=ServiceArgs,
        is_body_required=False,
        query=ServiceQuery,
        answers={200: ServiceAnswer},
        problems=(400, 409, 502, 504),
    ),
)

"""Everything that can go wrong in the simulator, for all of its modules.

    SimRobotProblem
    ├── SettingsProblem            the environment holds a value that cannot be used
    ├── MessageProblem             a message or a name does not fit its type
    │   ├── TypeUnknown
    │   ├── NameInvalid
    │   └── MessageMismatch
    ├── GraphProblem               the topic or service is not what the caller believes
    │   ├── TopicNotEstablished
    │   ├── TypeConflict
    │   └── ServiceUnknown
    ├── OperationProblem           a rosbridge operation is broken
    │   ├── MessageBroken
    │   ├── OperationUnknown
    │   ├── OperationRefused
    │   ├── FieldMissing
    │   ├── OperationFieldInvalid
    │   └── ClientLimit
    └── RequestProblem             a request to the video server is broken

Each class has a short code that stands in the log.
"""


class SimRobotProblem(Exception):  # noqa: N818  "problem" is the word of all parts for it
    """Root of the tree; its text is a sentence for a person."""

    code = "sim_robot_problem"


class SettingsProblem(SimRobotProblem):
    """A variable of the environment has a value that is not allowed."""

    code = "settings_invalid"


class MessageProblem(SimRobotProblem):
    """A message or a name does not fit its type."""

    code = "message_problem"


class TypeUnknown(MessageProblem):
    """No message type has this name."""

    code = "type_unknown"


class NameInvalid(MessageProblem):
    """This is no name that ROS would take for a topic."""

    code = "name_invalid"


class MessageMismatch(MessageProblem):
    """A message has a field that its type lacks, or a value of another type."""

    code = "message_mismatch"


class GraphProblem(SimRobotProblem):
    """The topic or service is not what the caller believes."""

    code = "graph_problem"


class TopicNotEstablished(GraphProblem):
    """Nobody has said yet which type the topic has."""

    code = "topic_not_established"


class TypeConflict(GraphProblem):
    """The topic exists with another type."""

    code = "type_conflict"


class ServiceUnknown(GraphProblem):
    """No node offers this service."""

    code = "service_unknown"


class OperationProblem(SimRobotProblem):
    """A rosbridge operation is broken."""

    code = "operation_problem"


class MessageBroken(OperationProblem):
    """What came is no JSON object."""

    code = "message_broken"


class OperationUnknown(OperationProblem):
    """The field `op` is missing or names nothing that exists."""

    code = "operation_unknown"


class OperationRefused(OperationProblem):
    """The real rosbridge knows this operation, the simulator does not offer it."""

    code = "operation_refused"


class FieldMissing(OperationProblem):
    """A field that the operation needs is not there."""

    code = "field_missing"


class OperationFieldInvalid(OperationProblem):
    """A field has a value of the wrong type or out of its range."""

    code = "field_invalid"


class ClientLimit(OperationProblem):
    """One client holds more topics than a client may."""

    code = "client_limit"


class RequestProblem(SimRobotProblem):
    """A request to the video server has a parameter that cannot be used."""

    code = "request_invalid"

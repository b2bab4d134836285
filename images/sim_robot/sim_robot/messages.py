"""The message types that the simulated robot knows, and the check of messages against them.

Used by the bus and by rosbridge. A real robot has the types that are installed on it; this one has
the table below. Names: `geometry_msgs/Twist` in ROS 1, `geometry_msgs/msg/Twist` in ROS 2, where
rosbridge takes the short form too. In here the short form is the key.
"""

import base64
import math
import struct
from collections.abc import Callable, Mapping
from typing import Any

Values = dict[str, Any]
Fields = tuple[tuple[str, str], ...]  # (name, type), in the order of the .msg file

_COMMON = {
    "ackermann_msgs/AckermannDrive": "float32 steering_angle, float32 steering_angle_velocity,"
    " float32 speed, float32 acceleration, float32 jerk",
    "ackermann_msgs/AckermannDriveStamped": "std_msgs/Header header, ackermann_msgs/AckermannDrive drive",
    # `level` is a byte, which rosbridge writes as a number.
    "diagnostic_msgs/DiagnosticArray": "std_msgs/Header header, diagnostic_msgs/DiagnosticStatus[] status",
    "diagnostic_msgs/DiagnosticStatus": "uint8 level, string name, string message, string hardware_id,"
    " diagnostic_msgs/KeyValue[] values",
    "diagnostic_msgs/KeyValue": "string key, string value",
    "std_msgs/Bool": "bool data",
    "std_msgs/ColorRGBA": "float32 r, float32 g, float32 b, float32 a",
    "std_msgs/Empty": "",
    "std_msgs/Float32": "float32 data",
    "std_msgs/Float64": "float64 data",
    "std_msgs/Int8": "int8 data",
    "std_msgs/Int16": "int16 data",
    "std_msgs/Int32": "int32 data",
    "std_msgs/Int64": "int64 data",
    "std_msgs/String": "string data",
    "std_msgs/UInt8": "uint8 data",
    "std_msgs/UInt16": "uint16 data",
    "std_msgs/UInt32": "uint32 data",
    "std_msgs/UInt64": "uint64 data",
    "geometry_msgs/Point": "float64 x, float64 y, float64 z",
    "geometry_msgs/Pose": "geometry_msgs/Point position, geometry_msgs/Quaternion orientation",
    "geometry_msgs/Pose2D": "float64 x, float64 y, float64 theta",
    "geometry_msgs/PoseStamped": "std_msgs/Header header, geometry_msgs/Pose pose",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose, float64[36] covariance",
    "geometry_msgs/Quaternion": "float64 x, float64 y, float64 z, float64 w",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation, geometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": "std_msgs/Header header, string child_frame_id,"
    " geometry_msgs/Transform transform",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear, geometry_msgs/Vector3 angular",
    "geometry_msgs/TwistStamped": "std_msgs/Header header, geometry_msgs/Twist twist",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist, float64[36] covariance",
    "geometry_msgs/Vector3": "float64 x, float64 y, float64 z",
    "nav_msgs/MapMetaData": "time map_load_time, float32 resolution, uint32 width, uint32 height,"
    " geometry_msgs/Pose origin",
    "nav_msgs/OccupancyGrid": "std_msgs/Header header, nav_msgs/MapMetaData info, int8[] data",
    "nav_msgs/Odometry": "std_msgs/Header header, string child_frame_id,"
    " geometry_msgs/PoseWithCovariance pose, geometry_msgs/TwistWithCovariance twist",
    "sensor_msgs/BatteryState": "std_msgs/Header header, float32 voltage, float32 temperature,"
    " float32 current, float32 charge, float32 capacity, float32 design_capacity, float32 percentage,"
    " uint8 power_supply_status, uint8 power_supply_health, uint8 power_supply_technology, bool present,"
    " float32[] cell_voltage, float32[] cell_temperature, string location, string serial_number",
    "sensor_msgs/CompressedImage": "std_msgs/Header header, string format, uint8[] data",
    "sensor_msgs/Image": "std_msgs/Header header, uint32 height, uint32 width, string encoding,"
    " uint8 is_bigendian, uint32 step, uint8[] data",
    "sensor_msgs/LaserScan": "std_msgs/Header header, float32 angle_min, float32 angle_max,"
    " float32 angle_increment, float32 time_increment, float32 scan_time, float32 range_min,"
    " float32 range_max, float32[] ranges, float32[] intensities",
    "sensor_msgs/PointCloud2": "std_msgs/Header header, uint32 height, uint32 width,"
    " sensor_msgs/PointField[] fields, bool is_bigendian, uint32 point_step, uint32 row_step, uint8[] data,"
    " bool is_dense",
    "sensor_msgs/PointField": "string name, uint32 offset, uint8 datatype, uint32 count",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "turtlesim/Pose": "float32 x, float32 y, float32 theta,"
    " float32 linear_velocity, float32 angular_velocity",
}
ROS_1, ROS_2 = 1, 2
_HEADER = {ROS_1: "uint32 seq, time stamp, string frame_id", ROS_2: "time stamp, string frame_id"}
_TIME_FIELDS = {ROS_1: ("secs", "nsecs"), ROS_2: ("sec", "nanosec")}
_QUATERNION = "geometry_msgs/Quaternion"
_INTEGERS = {
    f"int{bits}": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)
} | {f"uint{bits}": (0, 2**bits - 1) for bits in (8, 16, 32, 64)}
_FLOATS = ("float32", "float64")


def float32(value: float) -> float:
    """Round to what fits into a float32 field, as a real node would publish it."""
    try:
        rounded: float = struct.unpack("<f", struct.pack("<f", value))[0]
    except OverflowError:
        return math.copysign(math.inf, value)
    return rounded


class SimRobotError(Exception):
    """What a client asked for cannot be done; the text is a sentence for a person."""


class TypeUnknownError(SimRobotError):
    """No message type has this name."""


class MessageMismatchError(SimRobotError):
    """A message has a field that its type lacks, or a value of another type."""


class MessageTypes:
    """All message types of one ROS version (1 or 2)."""

    def __init__(self, ros_version: int) -> None:
        self.ros_version = ros_version
        self._time_fields = _TIME_FIELDS[ros_version]
        definitions = _COMMON | {"std_msgs/Header": _HEADER[ros_version]}
        self._fields = {key: parse_fields(text) for key, text in definitions.items()}

    def key_of(self, name: str) -> str:
        """Find the key of a type that a client named, or raise TypeUnknownError."""
        parts = name.split("/")
        if self.ros_version == ROS_2 and parts[1:2] == ["msg"]:
            del parts[1]
        key = "/".join(parts)
        if key not in self._fields:
            raise TypeUnknownError(
                f"cannot use message type {name}: the simulated robot (ROS {self.ros_version})"
                " has no such type"
            )
        return key

    def name_of(self, key: str, kind: str = "msg") -> str:
        """Spell a type as this ROS version does; `kind` is msg or srv."""
        return key.replace("/", f"/{kind}/", 1) if self.ros_version == ROS_2 else key

    def fields(self, key: str) -> Fields:
        """Give the fields of a type."""
        return self._fields[key]

    def is_message(self, field_type: str) -> bool:
        """Tell whether a field's type is a message itself."""
        return field_type in self._fields

    def time(self, stamp_ns: int) -> Values:
        """Write a time as this ROS version does."""
        seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
        return dict(zip(self._time_fields, (seconds, nanoseconds), strict=True))

    def header(self, frame_id: str, stamp_ns: int, seq: int) -> Values:
        """Make a std_msgs/Header."""
        stamped = {"stamp": self.time(stamp_ns), "frame_id": frame_id}
        return {"seq": seq % 2**32} | stamped if self.ros_version == ROS_1 else stamped

    def conform(self, key: str, values: object, now_ns: int) -> Values:
        """Give the whole message: fields that are left out get defaults, a header gets the time.

        Raises MessageMismatchError for a field that the type lacks or a value that does not fit.
        """
        return self.conform_fields(self.name_of(key), self._fields[key], values, now_ns)

    def conform_fields(self, what: str, fields: Fields, values: object, now_ns: int) -> Values:
        """Do the same for a list of fields that is no message type, as a service's request."""
        return _Conformer(self, what, now_ns).message(fields, values, "")


def parse_fields(text: str) -> Fields:
    """Read `type name, type name`."""
    pairs = (part.split() for part in text.split(",") if part.strip())
    return tuple((name, field_type) for field_type, name in pairs)


class _Conformer:
    """One check of one message; `path` names the field under way in errors."""

    def __init__(self, types: MessageTypes, what: str, now_ns: int) -> None:
        self._types = types
        self._what = what
        self._now_ns = now_ns

    def message(self, fields: Fields, values: object, path: str) -> Values:
        if not isinstance(values, Mapping):
            raise self._mismatch(path, "an object", values)
        members = dict(fields)
        for name in values:
            if name not in members:
                raise MessageMismatchError(f"{self._what} has no field {path}{name}")
        return {
            name: self._field(field_type, values[name], f"{path}{name}")
            if name in values
            else self._default(name, field_type)
            for name, field_type in fields
        }

    def _field(self, field_type: str, value: object, path: str) -> Any:
        if field_type.endswith("]"):
            return self._array(field_type, value, path)
        if field_type == "time":
            return self._time(value, path)
        if self._types.is_message(field_type):
            return self.message(self._types.fields(field_type), value, path + ".")
        return self._primitive(field_type, value, path)

    def _primitive(self, field_type: str, value: object, path: str) -> Any:
        if field_type in _FLOATS and isinstance(value, int | float) and not isinstance(value, bool):
            return float(value)
        if field_type in _INTEGERS and isinstance(value, int) and not isinstance(value, bool):
            low, high = _INTEGERS[field_type]
            if low <= value <= high:
                return value
        if field_type == "bool" and isinstance(value, bool):
            return value
        if field_type == "string" and isinstance(value, str):
            return value
        raise self._mismatch(path, field_type, value)

    def _array(self, field_type: str, value: object, path: str) -> Any:
        item_type, _, length = field_type[:-1].partition("[")
        if item_type == "uint8":
            return self._bytes(value, path)
        if not isinstance(value, list) or (length and len(value) != int(length)):
            raise self._mismatch(path, field_type, value)
        return [self._field(item_type, item, f"{path}[{i}]") for i, item in enumerate(value)]

    def _bytes(self, value: object, path: str) -> str:
        """Take base64 or a list of numbers and keep base64, which is how rosbridge writes bytes."""
        try:
            data = base64.b64decode(value, validate=True) if isinstance(value, str) else None
            if isinstance(value, list):
                data = bytes(value)
        except (ValueError, TypeError) as error:
            raise self._mismatch(path, "base64 or bytes", value) from error
        if data is None:
            raise self._mismatch(path, "base64 or bytes", value)
        return base64.b64encode(data).decode()

    def _time(self, value: object, path: str) -> Values:
        if value == "now":
            return self._types.time(self._now_ns)
        if not isinstance(value, Mapping):
            raise self._mismatch(path, "time", value)
        seconds = value.get("sec", value.get("secs", 0))
        nanoseconds = value.get("nanosec", value.get("nsecs", 0))
        if type(seconds) is not int or type(nanoseconds) is not int:
            raise self._mismatch(path, "time", value)
        return self._types.time(seconds * 1_000_000_000 + nanoseconds)

    def _default(self, name: str, field_type: str) -> Any:
        if field_type == "std_msgs/Header":
            return self._types.header("", self._now_ns, 0)
        if self._types.is_message(field_type):
            message = self.message(self._types.fields(field_type), {}, name + ".")
            if field_type == _QUATERNION and self._types.ros_version == ROS_2:
                message["w"] = 1.0  # only ROS 2 gives a quaternion that is a rotation
            return message
        if field_type.endswith("]"):
            item_type, _, length = field_type[:-1].partition("[")
            if item_type == "uint8":
                return ""
            return [self._default(name, item_type) for _ in range(int(length or 0))]
        if field_type == "time":
            # A header that came without a stamp gets one, as rosbridge does.
            return self._types.time(self._now_ns if name == "stamp" else 0)
        return _DEFAULTS[field_type]()

    def _mismatch(self, path: str, expected: str, value: object) -> MessageMismatchError:
        where = f"field {path.rstrip('.')}" if path else "the message"
        return MessageMismatchError(
            f"{self._what}: {where} must be {expected}, not {type(value).__name__} {value!r:.60}"
        )


_DEFAULTS: dict[str, Callable[[], Any]] = {"bool": bool, "string": str}
_DEFAULTS |= dict.fromkeys(_FLOATS, float) | dict.fromkeys(_INTEGERS, int)


def finite_or_none(value: Any) -> Any:
    """Replace NaN and infinity, which JSON cannot hold, by null everywhere in a message."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: finite_or_none(item) for key, item in value.items()}
    if isinstance(value, list):
        return [finite_or_none(item) for item in value]
    return value

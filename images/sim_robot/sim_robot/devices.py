"""What the robot has beside wheels and camera: scanner and map, battery, lights, a dock, diagnostics, and services.

Called by simulator.py, `Sensors` five times a second and `Devices` once. Nothing is measured while nobody listens.
Ranges beyond the scanner's reach are infinite, which rosbridge writes as null. transforms.py says where the scanner
is. `/sim/freeze_camera` is the simulator's own and on no real robot: while it is on, no
camera gives a new picture, so that tests see what a stalled camera does.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

from sim_robot.camera import FrameFeed
from sim_robot.graph import Graph, Handler, Node, Service, TopicMessage
from sim_robot.kinematics import STANDING
from sim_robot.messages import Fields, Values
from sim_robot.robot import RobotNode
from sim_robot.transforms import LASER_FRAME, MAP_FRAME, Mount
from sim_robot.world import World

NODE = Node("/sim_devices")
BATTERY, DIAGNOSTICS, LIGHTS = "/battery_state", "/diagnostics", "/lights"
HELP = "/robotether/help"
STEP_S = 1.0
BATTERY_LOW = 0.2
FULL_V, EMPTY_V = 29.4, 22.0
DRAIN_STANDING, DRAIN_DRIVING, CHARGE = 1 / 28_800, 1 / 7_200, 1 / 200  # of all it holds, a second
CHARGING, DISCHARGING, FULL = 1, 2, 4  # POWER_SUPPLY_STATUS_*
HEALTH_GOOD, TECHNOLOGY_LION = 1, 2
OK, WARN = 0, 1
SENSORS_NODE = Node("/sim_sensors")
SCAN, MAP = "/scan", "/map"
SCAN_HZ = 5.0
RAYS = 180
RANGE_MIN_M, RANGE_MAX_M = 0.1, 12.0
CELL_M, CELLS_MAX = 0.1, 200
_SWITCH: Fields = (("data", "bool"),)
_NOTHING: Fields = ()


@dataclass
class BatteryModel:
    """How full it is, from 0 to 1, and whether it charges: it drains with time and more with driving."""

    level: float = 0.81
    charging: bool = False

    def step(self, seconds: float, *, driving: bool) -> None:
        """Let time pass; a robot that drives has left its dock."""
        self.charging = self.charging and not driving
        drain = DRAIN_DRIVING if driving else DRAIN_STANDING
        change = CHARGE if self.charging else -drain
        self.level = min(max(self.level + change * seconds, 0.0), 1.0)

    @property
    def status(self) -> int:
        """The power supply's status."""
        if not self.charging:
            return DISCHARGING
        return FULL if self.level >= 1.0 else CHARGING

    def values(self, header: Values) -> Values:
        """Write a sensor_msgs/BatteryState; what is not measured is not a number."""
        return {
            "header": header,
            "voltage": round(EMPTY_V + (FULL_V - EMPTY_V) * self.level, 2),
            "temperature": math.nan,
            "current": math.nan,
            "charge": math.nan,
            "capacity": math.nan,
            "design_capacity": math.nan,
            "percentage": round(self.level, 4),
            "power_supply_status": self.status,
            "power_supply_health": HEALTH_GOOD,
            "power_supply_technology": TECHNOLOGY_LION,
            "present": True,
            "cell_voltage": [],
            "cell_temperature": [],
            "location": "base",
            "serial_number": "simulated",
        }


class Devices:
    """Battery, lights and services of one robot."""

    def __init__(self, graph: Graph, robot: RobotNode, feeds: Sequence[FrameFeed]) -> None:
        self._graph = graph
        self._robot = robot
        self._feeds = feeds
        self._seq = 0
        self.battery = BatteryModel()
        self.lights = False
        graph.bus.advertise(BATTERY, "sensor_msgs/BatteryState", NODE)
        graph.bus.advertise(DIAGNOSTICS, "diagnostic_msgs/DiagnosticArray", NODE)
        graph.bus.subscribe(LIGHTS, "std_msgs/Bool", NODE, self._on_lights)
        self._offer("/dock", "std_srvs/Trigger", _NOTHING, self._dock)
        graph.bus.advertise(HELP, "std_msgs/String", NODE)
        self._offer("/call_for_help", "std_srvs/Trigger", _NOTHING, self._call_for_help)
        self._offer("/set_lights", "std_srvs/SetBool", _SWITCH, self._set_lights)
        self._offer("/sim/freeze_camera", "std_srvs/SetBool", _SWITCH, self._freeze_camera)

    def step(self) -> None:
        """Let a second pass, and tell those who listen."""
        self._seq += 1
        self.battery.step(STEP_S, driving=self._is_driving)
        bus = self._graph.bus
        if bus.has_subscribers(BATTERY):
            bus.publish(BATTERY, self.battery.values(self._header()))
        if bus.has_subscribers(DIAGNOSTICS):
            bus.publish(DIAGNOSTICS, {"header": self._header(), "status": self._statuses()})

    @property
    def _is_driving(self) -> bool:
        return self._robot.turtle.velocity != STANDING

    def _header(self) -> Values:
        return self._graph.types.header("", time.time_ns(), self._seq)

    def _offer(self, name: str, key: str, request: Fields, handler: Handler) -> None:
        self._graph.services.add(Service(name, key, NODE.name, request, handler))

    def _on_lights(self, message: TopicMessage) -> None:
        self.lights = message.values["data"]

    def _dock(self, _request: Values) -> Values:
        if self._is_driving:
            return _answer("cannot dock: the robot drives; let it stand first", success=False)
        self.battery.charging = True
        return _answer("docked, the battery charges")

    def _call_for_help(self, _request: Values) -> Values:
        if not self._graph.bus.has_subscribers(HELP):
            return _answer("cannot call for help: nobody listens", success=False)
        self._graph.bus.publish(HELP, {"data": "I need a person"})
        return _answer("called for help")

    def _set_lights(self, request: Values) -> Values:
        self.lights = request["data"]
        return _answer("lights on" if self.lights else "lights off")

    def _freeze_camera(self, request: Values) -> Values:
        for feed in self._feeds:
            feed.freeze(request["data"])
        return _answer("cameras frozen" if request["data"] else "cameras run")

    def _statuses(self) -> list[Values]:
        frozen = any(feed.is_frozen for feed in self._feeds)
        at_wall = self._robot.turtle.at_wall
        low = self.battery.level < BATTERY_LOW
        return [
            _status("drive", WARN if at_wall else OK, "at a wall" if at_wall else "free", {}),
            _status("camera", WARN if frozen else OK, "frozen" if frozen else "runs", {}),
            _status(
                "battery",
                WARN if low else OK,
                "low" if low else "charging" if self.battery.charging else "discharging",
                {"percent": f"{self.battery.level * 100:.1f}"},
            ),
            _status("lights", OK, "on" if self.lights else "off", {"on": str(self.lights).lower()}),
        ]


def _answer(message: str, *, success: bool = True) -> Values:
    return {"success": success, "message": message}


def _status(name: str, level: int, message: str, values: dict[str, str]) -> Values:
    return {
        "level": level,
        "name": name,
        "message": message,
        "hardware_id": "simulated",
        "values": [{"key": key, "value": value} for key, value in values.items()],
    }


class Sensors:
    """Looks around from where the robot is."""

    def __init__(self, graph: Graph, robot: RobotNode, world: World, laser: Mount) -> None:
        self._graph = graph
        self._robot = robot
        self._laser = laser
        self._world = world
        self._seq = 0
        graph.bus.advertise(SCAN, "sensor_msgs/LaserScan", SENSORS_NODE)
        graph.bus.advertise(MAP, "nav_msgs/OccupancyGrid", SENSORS_NODE)
        graph.bus.publish(MAP, self._map(), latched=True)

    def step(self) -> None:
        """Publish a scan, if somebody listens."""
        self._seq += 1
        if self._graph.bus.has_subscribers(SCAN):
            self._graph.bus.publish(SCAN, self._scan())

    def _scan(self) -> Values:
        eye, step = self._laser.placed(self._robot.turtle.pose), 2 * math.pi / RAYS
        rays = (self._laser.heading(number * step - math.pi) for number in range(RAYS))
        return {
            "header": self._graph.types.header(LASER_FRAME, time.time_ns(), self._seq),
            "angle_min": -math.pi,
            "angle_max": math.pi - step,
            "angle_increment": step,
            "time_increment": 0.0,
            "scan_time": 1 / SCAN_HZ,
            "range_min": RANGE_MIN_M,
            "range_max": RANGE_MAX_M,
            "ranges": [
                _in_range(self._world.distance(eye.x, eye.y, eye.theta + ray)) for ray in rays
            ],
            "intensities": [],
        }

    def _map(self) -> Values:
        start, now_ns = self._robot.turtle.start, time.time_ns()
        cells = min(round(self._world.size_m / CELL_M), CELLS_MAX)
        corner = {"x": -start.x, "y": -start.y, "z": 0.0}
        return {
            "header": self._graph.types.header(MAP_FRAME, now_ns, 1),
            "info": {
                "map_load_time": self._graph.types.time(now_ns),
                "resolution": self._world.size_m / cells,
                "width": cells,
                "height": cells,
                "origin": {
                    "position": corner,
                    "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
                },
            },
            "data": self._world.grid(cells),
        }


def _in_range(distance_m: float) -> float:
    return round(distance_m, 3) if distance_m <= RANGE_MAX_M else math.inf

"""Why a command does not reach a robot, each as a sentence for the person who sent it.

FleetProblem
├── RobotsUnknown     robots_unknown
├── ConfigUnusable    ssh_config_unusable
├── Unreachable       robot_unreachable
├── HostKeyUnknown    host_key_unknown
├── HostKeyChanged    host_key_changed
├── LoginRefused      ssh_login_refused
└── CommandCut        command_cut
"""

from robotether_server.problems import Problem


class FleetProblem(Problem):
    """A command cannot be run, on one robot or on all."""


class RobotsUnknown(FleetProblem):
    """A pattern names no robot."""

    code = "robots_unknown"


class ConfigUnusable(FleetProblem):
    """OpenSSH's configuration cannot be read, or asks for what this command cannot do."""

    code = "ssh_config_unusable"


class Unreachable(FleetProblem):
    """The robot or its jump host does not answer."""

    code = "robot_unreachable"


class HostKeyUnknown(FleetProblem):
    """Nobody has compared this host's key yet."""

    code = "host_key_unknown"


class HostKeyChanged(FleetProblem):
    """The host shows another key than the known one, or one that is revoked."""

    code = "host_key_changed"


class LoginRefused(FleetProblem):
    """The host takes none of the person's keys."""

    code = "ssh_login_refused"


class CommandCut(FleetProblem):
    """The command did not finish."""

    code = "command_cut"

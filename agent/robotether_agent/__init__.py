"""The agent of Robotether: the boot service on a robot that keeps its tunnel to the server open."""

__version__ = "0.1.0"

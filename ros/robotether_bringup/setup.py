"""Installs the launch file where `ros2 launch` looks for it."""

from setuptools import setup

NAME = "robotether_bringup"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/robotether.launch.xml"]),
    ],
    zip_safe=True,
)

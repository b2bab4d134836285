"""A drive: its commands on their way to the robot, and what it came to."""

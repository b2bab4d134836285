"""What an operator or a program connects to: a robot's rosbridge, its cameras, and the events of the fleet."""

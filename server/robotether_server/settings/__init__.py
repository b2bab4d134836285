"""What can be set: the server by its environment, each robot, its drive page and its buttons by records."""

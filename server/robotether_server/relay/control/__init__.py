"""Who drives a robot, who waits, and who stopped it."""

"""Routes: what a topic of one robot brings goes to a topic of another, for which the relay drives that one."""

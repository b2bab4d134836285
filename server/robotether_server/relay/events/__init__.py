"""The fleet as server-sent events."""

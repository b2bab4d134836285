"""Connects an operator's WebSocket to a robot's rosbridge: every message is checked and written again."""

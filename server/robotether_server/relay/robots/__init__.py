"""Robots' sessions: who is connected, the lines between agent and relay, and the way to a robot's ports."""

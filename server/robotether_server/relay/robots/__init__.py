"""Robots' sessions: who is connected, the lines between agent and relay, and connections to robots' ports."""

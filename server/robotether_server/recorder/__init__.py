"""The recorder: one more observer of robots, which writes what it sees into MCAP files.

A process of its own (`main`), which nothing waits for: neither a robot nor a driver notices when it ends.
"""

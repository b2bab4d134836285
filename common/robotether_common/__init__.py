"""What both ends of the wire know: the agent on a robot and the server.

Both wheels contain this package. It imports nothing of either, and nothing but the standard library.
"""

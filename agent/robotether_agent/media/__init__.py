"""Lets video use the uplink without standing in front of control; what others use is `MediaDoor` in door.py.

door -> budget -> pace, meters (pure); connection_state (what the kernel knows of the SSH connection)
"""

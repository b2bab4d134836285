"""Frames to the server, which use the uplink without standing in front of control.

video_proxy -> pacer -> bandwidth_estimator (pure); connection_state (what the kernel knows of the SSH connection)
"""

"""Checks every step from the settings to the end-to-end path, for `robotether-agent doctor`.

Looks only: it changes nothing on the robot, joins nothing, and logs in nowhere.
"""

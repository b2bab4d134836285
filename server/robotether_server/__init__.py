"""Robotether's cloud side: `web` (Flask), `relay` (asyncio), `cli` and the database's SQL under all three.

Imports go one way: settings, problems -> db -> relay, and db -> services -> cli, and services -> api -> web.
web and relay never meet.
"""

__version__ = "0.1.0"

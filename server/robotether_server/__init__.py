"""Robotether's cloud side: `web` (Flask), `relay` (asyncio), `cli` and the store under all three.

Imports go one way: settings, problems -> store -> web, relay, cli; web and relay never meet.
"""

__version__ = "0.1.0"

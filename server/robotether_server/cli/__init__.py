"""The admin's command `robotether`, in the server image, and a person's own `robotether fleet`.

Every change leaves an audit event. What cannot be done is said in one sentence, with exit status 1.
The relay is not started from here, as web and relay share no process: `python -m robotether_server.relay`.
"""

from robotether_server.cli.main import main

__all__ = ["main"]

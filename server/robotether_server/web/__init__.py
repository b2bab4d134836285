"""The pages, and the Flask application that serves them and the REST API; it runs under gunicorn, behind nginx.

The only writer of users' logins and of robots' joins. Must never talk to the relay: what web permits,
it signs into a ticket.
"""

from robotether_server.web.app import create_app

__all__ = ["create_app"]

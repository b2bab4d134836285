"""What gunicorn calls: `robotether_server.web.wsgi:make_app()`; started by `robotether web`."""

import logging
import os

from flask import Flask

from robotether_server import settings
from robotether_server.web import create_app


def make_app() -> Flask:
    """Read the environment, and return the application."""
    loaded = settings.load_web(os.environ)
    logging.basicConfig(
        level=loaded.log_level.upper(), format="%(asctime)s %(levelname)s %(name)s: %(message)s"
    )
    return create_app(loaded)

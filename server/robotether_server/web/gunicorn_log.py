"""gunicorn's own lines as JSON; `robotether web` names this class with LOG_FORMAT=json."""

from gunicorn.config import Config  # type: ignore[import-untyped] # it has no types
from gunicorn.glogging import Logger  # type: ignore[import-untyped] # as above

from robotether_server.logs import write_json


class JsonLogger(Logger):  # type: ignore[misc] # as above
    """gunicorn's logger, which writes JSON."""

    def setup(self, cfg: Config) -> None:
        """Set up the handlers as ever, and let them write JSON."""
        super().setup(cfg)
        write_json(*self.error_log.handlers)

"""Web on a free port, over TLS as a program of a site reaches it through nginx, or without."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from api_visitor import Program, program_of
from web_visitor import Browser
from werkzeug.serving import make_server

ENDS_WITHIN_S = 10.0


@dataclass
class TlsWeb:
    app: Any
    database: Any
    certificate: Path | None
    address: str = ""
    requests: list[str] = field(default_factory=list)
    _programs: dict[str, Program] = field(default_factory=dict)

    def program(self, user: str) -> Program:
        if user not in self._programs:
            visitor = Browser(self.app.test_client(use_cookies=False))
            self._programs[user] = program_of(visitor, self.database, user)
        return self._programs[user]

    def token(self, user: str) -> str:
        return self.program(user).headers["Authorization"].removeprefix("Bearer ")

    def as_nginx_asks(
        self, environ: dict[str, Any], respond: Callable[..., Any]
    ) -> Iterable[bytes]:
        """Answer a request with the headers that nginx adds."""
        self.requests.append(environ["PATH_INFO"])
        environ |= {"HTTP_X_FORWARDED_FOR": "198.51.100.7", "HTTP_X_FORWARDED_PROTO": "https"}
        return self.app(environ, respond)


@contextmanager
def running(app: Any, database: Any = None, certificate: Path | None = None) -> Iterator[TlsWeb]:
    web = TlsWeb(app, database, certificate)
    files = None if certificate is None else (str(certificate), str(certificate))
    server = make_server("127.0.0.1", 0, web.as_nginx_asks, threaded=True, ssl_context=files)
    web.address = f"127.0.0.1:{server.port}"
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield web
    finally:
        server.shutdown()
        thread.join(ENDS_WITHIN_S)
        server.server_close()

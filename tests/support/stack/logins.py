"""Logs a person in at a running stack as a browser does, without one."""

from __future__ import annotations

import json
import re
import urllib.error
import urllib.parse
import urllib.request
from http.cookiejar import CookieJar
from typing import Any

from local_network import insecure_tls

CSRF = re.compile(r'name="csrf-token" content="([^"]+)"')


class Login:
    def __init__(self, url: str, name: str, password: str) -> None:
        self._url = url
        self._jar = CookieJar()
        self._browser = urllib.request.build_opener(
            urllib.request.HTTPSHandler(context=insecure_tls()),
            urllib.request.HTTPCookieProcessor(self._jar),
        )
        form = {"csrf_token": self._csrf("/login"), "name": name, "password": password, "next": ""}
        sent = urllib.parse.urlencode(form).encode()
        with self._browser.open(f"{url}/login", sent, timeout=10) as answer:
            self.page: str = answer.read().decode()
            self.is_in = not answer.url.endswith("/login")

    @property
    def cookies(self) -> dict[str, str]:
        return {cookie.name: cookie.value or "" for cookie in self._jar}

    def create(self, path: str, body: dict[str, Any]) -> Any:
        request = urllib.request.Request(
            f"{self._url}/api/v1{path}",
            data=json.dumps(body).encode(),
            headers={"Content-Type": "application/json", "X-CSRFToken": self._csrf("/profile")},
        )
        request.add_header("Referer", f"{self._url}/profile")
        with self._browser.open(request, timeout=10) as answer:
            return json.load(answer)

    def _csrf(self, path: str) -> str:
        with self._browser.open(self._url + path, timeout=10) as page:
            token = CSRF.search(page.read().decode())
        assert token is not None, f"{path} has no token"
        return token[1]

"""What tests of a robot's settings send and look up."""

from __future__ import annotations

import html
import re
from typing import Any

from robotether_server.db import Database, audit, robots
from web_visitor import Browser

SETTINGS = "/robots/sim1/settings"
CAMERAS, DRIVING = f"{SETTINGS}/cameras", f"{SETTINGS}/driving"
BUTTONS, PERMISSIONS = f"{SETTINGS}/buttons", f"{SETTINGS}/permissions"
HELP = f"{SETTINGS}/help"
LIGHTS = {
    "name": "Lights on",
    "kind": "publish",
    "topic": "/lights",
    "type": "std_msgs/Bool",
    "msg": {"data": True},
    "confirm": False,
}
DOCK = {
    "name": "Dock",
    "kind": "call",
    "service": "/dock",
    "type": "std_srvs/Trigger",
    "args": {},
    "confirm": True,
}
LIGHTS_FORM = {
    "name": "Lights on",
    "kind": "publish",
    "target": "/lights",
    "type": "std_msgs/Bool",
    "sends": '{"data": true}',
}
DOCK_FORM = {
    "name": "Dock",
    "kind": "call",
    "target": "/dock",
    "type": "std_srvs/Trigger",
    "sends": "",
    "confirm": "yes",
}


def kept(database: Database, member: str) -> Any:
    """What is in the database of sim1's `page` or `buttons`."""
    with database.transaction() as tx:
        return robots.get(tx, "sim1").settings.get(member)


def names(database: Database) -> list[str]:
    return [button["name"] for button in kept(database, "buttons") or []]


def audited(database: Database, kind: str) -> list[tuple[str, dict[str, object]]]:
    with database.transaction() as tx:
        found = audit.find(tx, audit.AuditSearch(kind=kind))
    return [(item.actor, dict(item.details)) for item in found]


def problem_of(page: str) -> str:
    found = re.search(r'data-testid="form-problem">(.*?)</div>', page, re.S)
    assert found, page
    return " ".join(html.unescape(re.sub("<[^>]*>", "", found[1])).split())


def filled(browser: Browser, path: str) -> dict[str, Any]:
    form = re.findall(
        r'<form method="post" class="stack settings".*?</form>', browser.ask("GET", path).text, re.S
    )[0]
    found: dict[str, Any] = dict(re.findall(r'name="(was)" value="([^"]*)"', form))

    def put(name: str, value: str) -> None:
        if name in ("topic", "name", "turned_deg"):
            found.setdefault(name, []).append(html.unescape(value))
        else:
            found[name] = html.unescape(value)

    for name, attributes in re.findall(r'<input id="[^"]+" name="([^"]+)"([^>]*)>', form):
        if 'type="checkbox"' not in attributes or " checked" in attributes:
            put(name, re.findall(r'value="([^"]*)"', attributes)[0])
    areas = r'<textarea id="[^"]+" name="([^"]+)"[^>]*>\n([^<]*)</textarea>'
    for name, text in re.findall(areas, form):
        put(name, text.replace("\n", "\r\n"))
    selects = r'<select id="[^"]+" name="([^"]+)"[^>]*>(.*?)</select>'
    for name, options in re.findall(selects, form, re.S):
        put(name, re.findall(r'<option value="([^"]*)" selected', options)[0])
    return found

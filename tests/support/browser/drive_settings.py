"""What tests of a drive page's settings send and look up."""

from __future__ import annotations

import html
import re
from typing import Any

from robotether_server.db import Database, audit, robots
from web_visitor import Browser

SETTINGS = "/robots/sim1/settings"
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
    """The names of sim1's buttons, in their order."""
    return [button["name"] for button in kept(database, "buttons") or []]


def audited(database: Database, kind: str) -> list[tuple[str, dict[str, object]]]:
    """Who made such changes, and their details; the newest first."""
    with database.transaction() as tx:
        found = audit.find(tx, audit.AuditSearch(kind=kind))
    return [(one.actor, dict(one.details)) for one in found]


def problem_of(page: str) -> str:
    """The summary that a form came back with."""
    found = re.search(r'data-testid="form-problem">(.*?)</div>', page, re.S)
    assert found, page
    return " ".join(html.unescape(re.sub("<[^>]*>", "", found[1])).split())


def filled(browser: Browser) -> dict[str, Any]:
    """The page's form as a browser would send it, unchanged."""
    page = browser.ask("GET", SETTINGS).text
    form = page.split('data-testid="page-form"')[1]
    found: dict[str, Any] = {}
    for name, attributes in re.findall(r'<input id="[^"]+" name="(\w+)"([^>]*)>', form):
        if 'type="checkbox"' in attributes:
            if " checked" in attributes:
                found[name] = "yes"
            continue
        value = html.unescape(re.findall(r'value="([^"]*)"', attributes)[0])
        if name in ("topic", "name"):
            found.setdefault(name, []).append(value)
        else:
            found[name] = value
    selects = r'<select id="[^"]+" name="(\w+)"[^>]*>(.*?)</select>'
    for name, options in re.findall(selects, form, re.S):
        chosen = re.findall(r'<option value="([^"]*)" selected', options)[0]
        if name == "turned_deg":
            found.setdefault(name, []).append(chosen)
        else:
            found[name] = chosen
    return found

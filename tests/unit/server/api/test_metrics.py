"""The ways to the numbers of relay and web, which are an admin's."""

import datetime as dt
import json
import re

import pytest
from api_visitor import Program, in_person
from prometheus_client.parser import text_string_to_metric_families
from robotether_server.api.operations import OPERATIONS
from robotether_server.api.web_metrics import WebMetrics
from robotether_server.db import credentials, fleet
from robotether_server.db.fleet import Credential
from robotether_server.install_line import Certificate, SiteCertificates
from robotether_server.settings.server import SiteAddressSettings
from web_visitor import Browser


@pytest.mark.parametrize(
    ("path", "leads_to"),
    [("", "/relay-metrics"), ("?cell=b-1", "/relay-metrics?cell=b-1"), ("/web", None)],
)
def test_admins_alone_are_led_to_the_numbers(root, ann, program, path, leads_to):
    """The relay believes whoever comes to its inside, so that nobody else may be led there."""
    answer = root.ask("GET", f"/metrics{path}")
    assert answer.status_code == 200
    assert answer.headers.get("X-Accel-Redirect") == leads_to
    assert answer.content_type.startswith("text/plain; version=")
    refused = ann.ask("GET", f"/metrics{path}")
    assert (refused.status_code, "X-Accel-Redirect" in refused.headers) == (403, False)
    stranger = program.ask("GET", f"/api/v1/metrics{path}")
    assert (stranger.status_code, "X-Accel-Redirect" in stranger.headers) == (401, False)


def test_what_is_no_name_of_a_cell_leads_nowhere(root):
    for name in ("", "B", "b/../c", "b%0ac", "b%26c", "b" * 64):
        answer = root.ask("GET", f"/metrics?cell={name}")
        assert (answer.status_code, "X-Accel-Redirect" in answer.headers) == (422, False), name


def test_a_token_for_metrics_alone_reads_them_and_nothing_else(program, browser, relay_database):
    new = {"name": "prometheus", "only_for": "metrics"}
    assert in_person(browser, "ann").refused("POST", "/tokens", new) == (403, "grant_missing")
    made = in_person(browser, "root").ask("POST", "/tokens", new).json
    assert made["only_for"] == "metrics"
    prometheus = Program(program, {"Authorization": f"Bearer {made['token']}"})
    assert prometheus.ask("GET", "/metrics").headers["X-Accel-Redirect"] == "/relay-metrics"
    assert prometheus.ask("GET", "/metrics/web").status_code == 200
    others = [each for each in OPERATIONS if each.who not in {"metrics", "anybody"}]
    assert len(others) > 50
    for each in others:
        path = re.sub("<[a-z_]+>", "sim1", re.sub("<int:[a-z_]+>", "1", each.path))
        body = {} if each.body else None
        assert prometheus.refused(each.method, path, body) == (401, "token_invalid"), path
    with relay_database.transaction() as tx:
        token = Credential("token", credentials.digest(made["token"]))
        assert fleet.users_of(tx, [token]) == {}


def numbers_of(metrics):
    families = text_string_to_metric_families(metrics.render().decode())
    return {
        (sample.name.removeprefix("robotether_web_"), *sample.labels.values()): sample.value
        for family in families
        for sample in family.samples
    }


def test_requests_and_logins_are_counted_by_their_outcome(app):
    browser = Browser(app.test_client())
    browser.log_in("ann", "wrong")
    browser.log_in("ann")
    browser.ask("GET", "/nothing")
    numbers = numbers_of(app.extensions["robotether"].metrics)
    assert numbers["logins_total", "refused"] == numbers["logins_total", "accepted"] == 1
    assert numbers["logins_total", "throttled"] == 0
    # The form twice, a redirect, a wrong password and a page that is not there.
    classes = [numbers["requests_total", status] for status in ("2xx", "3xx", "4xx", "5xx")]
    assert classes == [2, 1, 2, 0]
    assert numbers["request_duration_seconds_count",] == 5


class EndingCertificate(SiteCertificates):
    def certificate(self, host):
        ends_at = dt.datetime(2027, 1, 1, tzinfo=dt.UTC)
        return Certificate("ab", "cd", is_known=True, ends_at=ends_at)


def test_refused_keys_and_the_certificate_are_read_and_unknown_has_no_value(app, admin_database):
    with admin_database.transaction() as tx:
        for details in ({"more": 3}, {"elsewhere": 2}):
            tx.insert(
                "INSERT INTO audit_events (actor, kind, details) VALUES ('sshd', 'key_refused', %s)",
                (json.dumps(details),),
            )
    context = app.extensions["robotether"]
    assert ("certificate_expiry_timestamp_seconds",) not in numbers_of(context.metrics)
    certificates = EndingCertificate(SiteAddressSettings(None, 443, ("nobody", 1)))
    numbers = numbers_of(WebMetrics(context.database, certificates))
    assert numbers["refused_keys",] == 7
    ends_at = dt.datetime.fromtimestamp(numbers["certificate_expiry_timestamp_seconds",], dt.UTC)
    assert ends_at.year == 2027

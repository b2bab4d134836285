"""The ways to the numbers of relay and web, which are an admin's."""

import datetime as dt
import json

import pytest
from prometheus_client.parser import text_string_to_metric_families
from robotether_server.api.web_metrics import WebMetrics
from robotether_server.install_line import Certificate, SiteCertificates
from robotether_server.settings.server import SiteAddressSettings
from web_visitor import Browser


@pytest.mark.parametrize(("path", "leads_to"), [("", "/relay-metrics"), ("/web", None)])
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
        return Certificate(
            "ab", "cd", is_known=True, ends_at=dt.datetime(2027, 1, 1, tzinfo=dt.UTC)
        )


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

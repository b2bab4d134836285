"""The way to the relay's numbers, which is an admin's."""


def test_admins_alone_are_led_to_the_numbers(root, ann, program):
    """The relay believes whoever comes to its inside, so that nobody else may be led there."""
    answer = root.ask("GET", "/metrics")
    assert answer.headers["X-Accel-Redirect"] == "/relay-metrics"
    assert answer.content_type.startswith("text/plain; version=")
    refused = ann.ask("GET", "/metrics")
    assert (refused.status_code, "X-Accel-Redirect" in refused.headers) == (403, False)
    stranger = program.ask("GET", "/api/v1/metrics")
    assert (stranger.status_code, "X-Accel-Redirect" in stranger.headers) == (401, False)

"""Prometheus' rules, as the image's own promtool reads them, and the image's programs without a site around them."""

import json
from contextlib import contextmanager
from pathlib import Path

import pytest
from commands import output_of_command, run_command
from image_names import image
from openssh_server import wait_until

TESTS = Path(__file__).parent
DASHBOARD = TESTS.parents[1] / "deploy" / "grafana" / "robotether.json"
LOCKED_DOWN = ("--read-only", "--cap-drop", "ALL", "--network", "none")
START_WITHIN_S = 60


def run(*arguments):
    return output_of_command("docker", *arguments, limit_s=120).strip()


@pytest.mark.parametrize(
    "arguments",
    [
        ("check", "config", "/etc/prometheus/prometheus.yml"),
        ("test", "rules", "/etc/prometheus/prometheus_rules.yml"),
        ("test", "rules", "/etc/prometheus/prometheus_times.yml"),
    ],
)
def test_promtool_is_content(arguments):
    """Each alert comes from its fault, in time, and from nothing else."""
    promtool(TESTS / Path(arguments[-1]).name, *arguments)


def promtool(file, *arguments):
    """Have promtool read the rules, and a file of ours beside them if there is one of that name."""
    mount = f"type=bind,source={file},target=/etc/prometheus/{file.name},readonly"
    more = ("--mount", mount) if file.exists() else ()
    # Where promtool keeps what it tests.
    options = ("--rm", *LOCKED_DOWN, "--tmpfs", "/tmp", *more, "--entrypoint", "promtool")
    run("run", *options, image("prometheus"), *arguments)


def test_promtool_reads_the_queries_of_the_dashboard(tmp_path):
    panels = json.loads(DASHBOARD.read_text())["panels"]
    queries = [target["expr"] for panel in panels for target in panel.get("targets", ())]
    rules = [
        {"record": f"query:{number}", "expr": query.replace("$__rate_interval", "5m")}
        for number, query in enumerate(queries)
    ]
    assert rules
    file = tmp_path / "dashboard.yml"
    # JSON is YAML, too.
    file.write_text(json.dumps({"groups": [{"name": "dashboard", "rules": rules}]}))
    tmp_path.chmod(0o755)
    promtool(file, "check", "rules", "/etc/prometheus/dashboard.yml")


@contextmanager
def running(*options, port):
    container = run("run", "--detach", *LOCKED_DOWN, *options, image("prometheus"))
    try:
        check = ("docker", "exec", container, "/usr/lib/robotether/healthy", str(port))
        wait_until(
            lambda: run_command(*check).returncode == 0,
            lambda: run("logs", container),
            START_WITHIN_S,
        )
        yield container
    finally:
        run("rm", "--force", "--volumes", container)


def test_it_starts_without_a_relay_and_without_rights():
    with running(port=9090):
        pass


ALERTMANAGER = (
    "--entrypoint", "/usr/lib/robotether/alertmanager",
    "--tmpfs", "/run/alertmanager:uid=33,gid=33,mode=0700",
)  # fmt: skip
MAIL = {
    "ALERT_EMAIL_TO": "ann@lab.example,ben@lab.example",
    "ALERT_EMAIL_FROM": "robots@lab.example",
    "ALERT_SMTP": "mail.lab.example:587",
    "ALERT_SMTP_USER": "robots",
}
# Status of timeout(1).
TIMED_OUT = 124


def environment(settings):
    return [part for name, text in settings.items() for part in ("--env", f"{name}={text}")]


def test_alertmanager_sends_where_the_settings_say_and_else_nowhere(tmp_path):
    tmp_path.chmod(0o755)
    (tmp_path / "alert_smtp_password").write_text("x" * 12)
    (tmp_path / "alert_webhook_url").write_text("https://hooks.lab.example/abc")
    secrets = ("--mount", f"type=bind,source={tmp_path},target=/run/secrets,readonly")
    show = ("amtool", "--alertmanager.url=http://127.0.0.1:9093", "config", "show")
    with running(*ALERTMANAGER, port=9093) as container:
        assert "_configs" not in run("exec", container, *show)
    with running(*ALERTMANAGER, *secrets, *environment(MAIL), port=9093) as container:
        shown = run("exec", container, *show)
    assert f"to: {MAIL['ALERT_EMAIL_TO']}" in shown
    assert f"smarthost: {MAIL['ALERT_SMTP']}" in shown
    assert "require_tls: true" in shown
    assert "url_file: /run/secrets/alert_webhook_url" in shown


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"ALERT_SMTP": ""}, "ALERT_SMTP is not"),
        ({"ALERT_EMAIL_TO": 'a@b"\nroute: {'}, "allowed are letters"),
        ({}, "alert_smtp_password is not there"),
    ],
)
def test_alertmanager_says_what_is_wrong(changes, reason):
    start = ["docker", "run", "--rm", *LOCKED_DOWN, "--entrypoint", "timeout", *ALERTMANAGER[2:]]
    start += [*environment(MAIL | changes), image("prometheus")]
    # It waits for a person.
    start += ["3", "/usr/lib/robotether/alertmanager"]
    done = run_command(*start)
    assert done.returncode == TIMED_OUT
    assert reason in done.stderr

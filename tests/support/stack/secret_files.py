"""Which secrets each service gets, by the names of their files."""

from __future__ import annotations

SECRETS_OF = {
    service: set(names.split())
    for service, names in {
        "mysql": (
            "mysql_web_password mysql_relay_password mysql_recorder_password"
            " mysql_keylookup_password mysql_migrate_password"
            " database_ca.pem database_cert.pem database_key.pem"
        ),
        "migrate": "mysql_migrate_password database_ca.pem admin_password",
        "web": "mysql_web_password ticket_key web_secret_key admin_password database_ca.pem",
        "relay": (
            "mysql_relay_password ticket_key session_key peer_cert.pem peer_key.pem database_ca.pem"
        ),
        "recorder": "mysql_recorder_password ticket_key database_ca.pem",
        "sshd": "mysql_keylookup_password session_key database_ca.pem",
        "demo": "mysql_web_password database_ca.pem",
        "nginx": "peer_cert.pem peer_key.pem",
        "alertmanager": "alert_smtp_password alert_webhook_url",
    }.items()
}

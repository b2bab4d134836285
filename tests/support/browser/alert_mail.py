"""An alert as the stack's Alertmanager mails it, caught by a mail server of this machine.

`screenshots` shows it. The demo's own Alertmanager stays as it is: another of the same image sends the mail.
"""

from __future__ import annotations

import html
import queue
from collections.abc import Iterator
from contextlib import contextmanager
from email import message_from_bytes
from email.message import EmailMessage
from email.policy import default
from socketserver import StreamRequestHandler, ThreadingTCPServer
from threading import Thread

from demo import Demo

START_WITHIN_S, SENT_WITHIN_S = 30, 60
ALERTMANAGER_URL = "--alertmanager.url=http://127.0.0.1:9093"
# As images/prometheus/rules.yml has it.
ALERT = (
    "alertname=CellDown",
    "instance=relay:9100",
    "job=robotether",
    "--annotation=summary=relay:9100 does not answer",
    "--annotation=what_to_do=docs/howto/metrics.md#celldown",
)


@contextmanager
def mail_server(address: str) -> Iterator[tuple[int, queue.Queue[bytes]]]:
    mails: queue.Queue[bytes] = queue.Queue()

    class MailHandler(StreamRequestHandler):
        def handle(self) -> None:
            self.wfile.write(b"220 mail.lab.example\r\n")
            for line in self.rfile:
                command = line.strip().upper()
                if command == b"DATA":
                    self.wfile.write(b"354 go on\r\n")
                    mails.put(b"".join(iter(self.rfile.readline, b".\r\n")))
                self.wfile.write(b"221 bye\r\n" if command == b"QUIT" else b"250 done\r\n")
                if command == b"QUIT":
                    return

    with ThreadingTCPServer((address, 0), MailHandler) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield server.server_address[1], mails
        finally:
            server.shutdown()


def alert_mail(demo: Demo) -> EmailMessage:
    with mail_server(demo.machine) as (port, mails):
        container = demo.engine.containers.run(
            str(demo.container("alertmanager").attrs["Image"]),
            entrypoint="/usr/lib/robotether/alertmanager",
            environment={
                "ALERT_EMAIL_TO": "ann@lab.example",
                "ALERT_EMAIL_FROM": "robots@lab.example",
                "ALERT_SMTP": f"{demo.machine}:{port}",
                "ALERT_SMTP_TLS": "no",
            },
            tmpfs={"/run/alertmanager": "uid=33,gid=33,mode=0700"},
            detach=True,
        )
        try:
            wait = f"timeout {START_WITHIN_S} sh -c 'until /usr/lib/robotether/healthy 9093; do sleep 0.2; done'"
            container.exec_run(["sh", "-c", wait])
            status, said = container.exec_run(["amtool", ALERTMANAGER_URL, "alert", "add", *ALERT])
            if status:
                raise RuntimeError(f"cannot add an alert: {said!r}")
            mail = mails.get(timeout=SENT_WITHIN_S)
        finally:
            container.remove(force=True, v=True)
    return message_from_bytes(mail, policy=default)


def as_page(mail: EmailMessage) -> str:
    heads = "".join(
        f"<div><b>{name}:</b> {html.escape(str(mail[name]))}</div>"
        for name in ("From", "To", "Subject")
    )
    body = mail.get_body(("html",))
    return f"<div style='font: 15px sans-serif; padding: 12px'>{heads}</div>{body and body.get_content()}"

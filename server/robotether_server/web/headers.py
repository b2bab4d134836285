"""The security headers of every answer."""

import re

from flask import Flask, Response, request

# Characters allowed in a policy, as a client writes the Host header.
HOST = re.compile(r"[A-Za-z0-9.-]+(:[0-9]+)?|\[[0-9A-Fa-f:.]+\](:[0-9]+)?")
# A joystick drives and the video fills the screen; nothing else of the operator's device is of use here.
PERMISSIONS_POLICY = ", ".join(
    (
        "gamepad=(self)",
        "fullscreen=(self)",
        *(
            f"{feature}=()"
            for feature in (
                "accelerometer",
                "camera",
                "display-capture",
                "geolocation",
                "gyroscope",
                "hid",
                "magnetometer",
                "microphone",
                "midi",
                "payment",
                "serial",
                "usb",
            )
        ),
    )
)


def register(app: Flask) -> None:
    """Add the headers to every answer of the application."""
    app.after_request(_add)


def _add(response: Response) -> Response:
    response.headers["Content-Security-Policy"] = content_security_policy(request.host)
    response.headers["Cross-Origin-Opener-Policy"] = "same-origin"
    response.headers["Permissions-Policy"] = PERMISSIONS_POLICY
    response.headers["Referrer-Policy"] = "same-origin"
    response.headers["X-Content-Type-Options"] = "nosniff"
    response.headers["X-Frame-Options"] = "DENY"
    # What depends on who asks must not come out of a cache for the next person.
    response.headers.setdefault("Cache-Control", "no-store")
    return response


def content_security_policy(host: str) -> str:
    """Return the policy of a page of this host, `NAME[:PORT]`."""
    # Beside 'self', because some browsers do not count wss://same-host as 'self'.
    sockets = f" wss://{host}" if HOST.fullmatch(host) else ""
    return "; ".join(
        (
            "default-src 'self'",
            "img-src 'self' blob: data:",
            f"connect-src 'self'{sockets}",
            "object-src 'none'",
            "base-uri 'none'",
            "form-action 'self'",
            "frame-ancestors 'none'",
        )
    )

"""What the front door lets through, asked of the running daemon."""

from __future__ import annotations

import gzip
import http.client
import socket
import ssl

import pytest
from local_network import insecure_tls
from stack import Stack


def test_plain_http_is_redirected(stack: Stack) -> None:
    """Port 80 answers nothing but a permanent redirect to https."""
    connection = http.client.HTTPConnection("localhost", stack.http_port, timeout=5)
    connection.request("GET", "/robots/sim1?x=1", headers={"Host": "robots.example"})
    answer = connection.getresponse()
    connection.close()
    assert answer.status == 308
    assert answer.getheader("Location") == "https://robots.example/robots/sim1?x=1"


@pytest.mark.parametrize("version", [ssl.TLSVersion.TLSv1_2, ssl.TLSVersion.TLSv1_3])
def test_tls_version_is_offered(stack: Stack, version: ssl.TLSVersion) -> None:
    """TLS 1.2 and 1.3 both connect."""
    context = insecure_tls()
    context.minimum_version = context.maximum_version = version
    with (
        socket.create_connection(("localhost", stack.https_port), timeout=5) as plain,
        context.wrap_socket(plain),
    ):
        pass


def test_old_tls_is_refused(stack: Stack) -> None:
    """A client that knows only TLS 1.1 is turned away."""
    context = insecure_tls()
    context.set_ciphers("ALL:@SECLEVEL=0")
    with pytest.warns(DeprecationWarning, match="TLSv1_1"):
        context.minimum_version = context.maximum_version = ssl.TLSVersion.TLSv1_1
    with (
        socket.create_connection(("localhost", stack.https_port), timeout=5) as plain,
        pytest.raises(ssl.SSLError, match=r"(?i)alert|version|protocol"),
    ):
        context.wrap_socket(plain)


def test_ssh_answers_on_443(stack: Stack) -> None:
    """A client that does not speak TLS meets OpenSSH on the same port."""
    with socket.create_connection(("localhost", stack.https_port), timeout=5) as plain:
        plain.sendall(b"SSH-2.0-test\r\n")
        assert plain.recv(64).startswith(b"SSH-2.0-OpenSSH")


@pytest.mark.parametrize(
    ("path", "encoding"),
    [("/static/dist/drive.js", "gzip"), ("/static/drive.css", "gzip"), ("/login", None)],
)
def test_scripts_and_styles_are_compressed(stack: Stack, path: str, encoding: str | None) -> None:
    """They travel as gzip and are whole; a page, which holds secrets, does not."""
    connection = http.client.HTTPSConnection(
        "localhost", stack.https_port, timeout=5, context=insecure_tls()
    )
    connection.request("GET", path, headers={"Accept-Encoding": "gzip"})
    answer = connection.getresponse()
    sent = answer.read()
    connection.request("GET", path, headers={"Accept-Encoding": "identity"})
    plain = connection.getresponse().read()
    connection.close()
    assert answer.getheader("Content-Encoding") == encoding
    if encoding:
        assert gzip.decompress(sent) == plain
        assert len(sent) < len(plain) / 2


def test_log_keeps_no_tickets(stack: Stack) -> None:
    """A ticket in a query never reaches the access log."""
    stack.request("GET", "/robots/sim1/ros?ticket=SECRET-TICKET")
    stack.wait("the request in nginx's log", lambda: "/robots/sim1/ros 4" in stack.logs("nginx"))
    assert "SECRET-TICKET" not in stack.logs("nginx", "relay", "web", lines=400)


@pytest.mark.parametrize("path", ["/metrics", "/healthz"])
def test_inside_pages_stay_inside(stack: Stack, path: str) -> None:
    """The relay's metrics are not to be had from outside."""
    _, body = stack.request("GET", path)
    assert "robotether_relay" not in str(body)


def test_configuration_in_force_is_ours(stack: Stack) -> None:
    """The daemon itself says that no distribution default is included."""
    printed = stack.exec("nginx", "nginx", "-T")
    assert "sites-enabled" not in printed
    assert "ssl_protocols TLSv1.2 TLSv1.3;" in printed


def test_kernel_keeps_little_for_slow_viewers(stack: Stack) -> None:
    """What is not under way yet to who watches a stream is bounded where nginx runs."""
    assert stack.exec("nginx", "cat", "/proc/sys/net/ipv4/tcp_notsent_lowat").strip() == "16384"


def test_frames_are_asked_for_by_an_upgrade(stack: Stack) -> None:
    """The upgrade for pictures reaches the relay, which wants to know who asks; on its neighbours it is none."""
    handshake = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
    }
    path = "/robots/sim1/video/frames?topic=/a"
    assert stack.request("GET", path, headers=handshake)[0] == 401
    # The relay sees a plain GET.
    assert stack.request("GET", path)[0] == 426

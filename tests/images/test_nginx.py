"""What nginx passes on, asked of the running daemon."""

import gzip
import http.client
import json
import socket
import ssl

import pytest
from commands import run_command
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID
from local_network import insecure_tls


@pytest.mark.parametrize("host", ["robots.example", "robots.example:80", "[2001:db8::1]"])
def test_plain_http_is_redirected(stack, host):
    connection = http.client.HTTPConnection("localhost", stack.http_port, timeout=5)
    connection.request("GET", "/robots/sim1?x=1", headers={"Host": host})
    answer = connection.getresponse()
    connection.close()
    assert answer.status == 308
    there = f"{host.removesuffix(':80')}:{stack.https_port}"
    assert answer.getheader("Location") == f"https://{there}/robots/sim1?x=1"


def shake_hands(stack, context, name=None):
    with (
        socket.create_connection(("localhost", stack.https_port), timeout=5) as plain,
        context.wrap_socket(plain, server_hostname=name),
    ):
        pass


def test_tls_1_2_and_1_3_are_offered_and_older_ones_refused(stack):
    for version in (ssl.TLSVersion.TLSv1_2, ssl.TLSVersion.TLSv1_3):
        context = insecure_tls()
        context.minimum_version = context.maximum_version = version
        shake_hands(stack, context)
    context = insecure_tls()
    context.set_ciphers("ALL:@SECLEVEL=0")
    with pytest.warns(DeprecationWarning, match="TLSv1_1"):
        context.minimum_version = context.maximum_version = ssl.TLSVersion.TLSv1_1
    with pytest.raises(ssl.SSLError, match=r"(?i)alert|version|protocol"):
        shake_hands(stack, context)


WEAK = [
    "ECDHE-ECDSA-AES128-SHA",
    "ECDHE-ECDSA-AES256-SHA384",
    "ECDHE-RSA-AES128-SHA",
    "AES128-GCM-SHA256",
]


@pytest.mark.parametrize("cipher", WEAK)
def test_weak_ciphers_of_tls_1_2_are_refused(stack, cipher):
    """CBC, SHA-1 and key exchanges without ephemeral keys are refused."""
    context = insecure_tls()
    context.maximum_version = ssl.TLSVersion.TLSv1_2
    context.set_ciphers(cipher)
    with pytest.raises(ssl.SSLError, match=r"(?i)handshake.failure"):
        shake_hands(stack, context)


@pytest.fixture
def self_signed(stack, tmp_path):
    """The file of the certificate that serves, for those who trust it alone."""
    file = tmp_path / "cert.pem"
    file.write_text(stack.exec("nginx", "cat", "/etc/nginx/tls/cert.pem"))
    return file


def test_self_signed_certificate_is_no_authority(self_signed):
    """Who trusts it trusts this server, and nothing that its key might sign."""
    made = x509.load_pem_x509_certificate(self_signed.read_bytes()).extensions
    constraints = made.get_extension_for_class(x509.BasicConstraints)
    assert (constraints.critical, constraints.value.ca) == (True, False)
    assert made.get_extension_for_class(x509.KeyUsage).value.digital_signature
    assert not made.get_extension_for_class(x509.KeyUsage).value.key_cert_sign
    purposes = list(made.get_extension_for_class(x509.ExtendedKeyUsage).value)
    assert purposes == [ExtendedKeyUsageOID.SERVER_AUTH]
    names = made.get_extension_for_class(x509.SubjectAlternativeName).value
    assert "localhost" in names.get_values_for_type(x509.DNSName)


def test_self_signed_certificate_is_its_own_trust_anchor(stack, self_signed):
    context = ssl.create_default_context(cafile=self_signed)
    context.verify_flags |= ssl.VERIFY_X509_STRICT
    shake_hands(stack, context, "localhost")
    url = f"{stack.url}/nginx-health"
    curl = ("curl", "--silent", "--show-error", "--fail", "--cacert", self_signed, url)
    done = run_command(*curl)
    assert (done.stdout, done.stderr) == ("ok\n", "")


@pytest.mark.parametrize(
    ("path", "cookie", "status"),
    [
        *[(path, "", 400) for path in ("/%00", "/a%00b", "/../..", "/%2e%2e/", "/%zz")],
        ("/" + "a" * 9000, "", 414),
        ("/", "a" * 9000, 431),
    ],
    ids=lambda value: str(value)[:10],
)
def test_requests_that_nobody_can_read_are_problems(stack, path, cookie, status):
    connection = http.client.HTTPSConnection(
        "localhost", stack.https_port, timeout=5, context=insecure_tls()
    )
    connection.request("GET", path, headers={"Cookie": cookie})
    answer = connection.getresponse()
    body = json.loads(answer.read())
    connection.close()
    assert answer.headers.get_content_type() == "application/problem+json"
    assert (answer.status, body["status"], body["code"]) == (status, status, "request_invalid")


def test_a_person_gets_a_page_in_place_of_a_problem(stack):
    connection = http.client.HTTPSConnection(
        "localhost", stack.https_port, timeout=5, context=insecure_tls()
    )
    headers = {"Sec-Fetch-Dest": "document", "Content-Length": str(2**20)}
    connection.request("POST", "/login", headers=headers)
    answer = connection.getresponse()
    assert (answer.status, answer.headers.get_content_type()) == (413, "text/html")
    assert b"What you sent is over 64 KB." in answer.read()
    connection.close()


# Holds connections that have passed to the server for TLS, each with a client's first message, and tries one more.
# Prints how many were answered, whether one more was, and how many are once the first are closed.
HOLD_PLACES = """
import resource, socket, ssl, sys, time
places, hard = int(sys.argv[1]), resource.getrlimit(resource.RLIMIT_NOFILE)[1]
resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
address, hello = (socket.gethostbyname("nginx"), 8443), ssl.MemoryBIO()
try:
    ssl.create_default_context().wrap_bio(ssl.MemoryBIO(), hello, server_hostname="localhost").do_handshake()
except ssl.SSLWantReadError:
    hello = hello.read()

def is_answered(connection):
    try:
        connection.sendall(hello)
        return connection.recv(1) != b""
    except ConnectionError:
        return False

held = [socket.create_connection(address, timeout=5) for _ in range(places)]
print(sum(map(is_answered, held)))
with socket.create_connection(address, timeout=5) as one_more:
    print(is_answered(one_more))
for connection in held:
    connection.close()
# nginx sees the ends a moment later.
again, ends_at = [], time.monotonic() + 60
while len(again) < places and time.monotonic() < ends_at:
    connection = socket.create_connection(address, timeout=5)
    if is_answered(connection):
        again.append(connection)
print(len(again))
"""


def test_one_address_has_1000_connections_and_gets_them_back(stack):
    """The next one is closed without an answer."""
    printed = stack.exec("web", "python3", "-c", HOLD_PLACES, "1000")
    assert printed.split() == ["1000", "False", "1000"]


def test_one_address_cannot_take_all_connections_by_port_80(stack):
    """Requests that never end hold 100 places, and nobody else's."""
    begun = []
    try:
        for _ in range(150):
            begun.append(socket.create_connection(("localhost", stack.http_port), timeout=5))
            begun[-1].sendall(b"GET / HT")
            begun[-1].setblocking(False)
        stack.wait("those beyond are closed", lambda: sum(map(_is_closed, begun)) >= 50)
        assert stack.request("GET", "/nginx-health")[0] == 200
    finally:
        for connection in begun:
            connection.close()


def _is_closed(connection):
    try:
        return connection.recv(1) == b""
    except BlockingIOError:
        return False
    except ConnectionError:
        return True


# Asks for more than one address may, from the address of the container in which it runs.
FLOOD = """
import asyncio, collections, sys, aiohttp

site, headers = "https://nginx:8443", {"Authorization": "Bearer rt_unknown"}

async def status(http, method, path):
    async with http.request(method, f"{site}/api/v1/robots/sim1/{path}", headers=headers) as answer:
        return answer.status

async def main():
    async with aiohttp.ClientSession(connector=aiohttp.TCPConnector(limit=0, ssl=False)) as http:
        asked = [asyncio.create_task(status(http, "GET", sys.argv[1])) for _ in range(900)]
        await asyncio.wait(asked, return_when=asyncio.FIRST_COMPLETED)
        while not any(task.done() and task.result() == 429 for task in asked):
            await asyncio.wait([task for task in asked if not task.done()], return_when=asyncio.FIRST_COMPLETED)
        print(await status(http, "POST", "stop"))
        found = collections.Counter(await asyncio.gather(*asked))
        print(*sorted(found))

asyncio.run(main())
"""


@pytest.mark.parametrize("path", ["control", "control?ticket=any"])
def test_a_flood_of_strangers_is_cut_and_leaves_stops_their_places(stack, path):
    """Beyond its burst an address gets 429, while a stop from there reaches the relay, which does not know who asks.

    A ticket where none is read changes nothing.
    """
    # With the memory for as many connections at once, if the machine is slow.
    assert stack.exec("relay", "python3", "-c", FLOOD, path).split() == ["401", "401", "429"]


@pytest.mark.parametrize(
    ("path", "encoding"),
    [("/static/dist/drive.js", "gzip"), ("/static/drive.css", "gzip"), ("/login", None)],
)
def test_scripts_and_styles_are_compressed(stack, path, encoding):
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


def test_log_keeps_no_tickets(stack):
    stack.request("GET", "/robots/sim1/ros?ticket=SECRET-TICKET")
    stack.wait("the request in nginx's log", lambda: "/robots/sim1/ros 4" in stack.logs("nginx"))
    assert "SECRET-TICKET" not in stack.logs("nginx", "relay", "web", lines=400)


@pytest.mark.parametrize("path", ["/metrics", "/relay-metrics", "/api/v1/metrics", "/healthz"])
def test_inside_pages_stay_inside(stack, path):
    """The relay's metrics are not to be had from outside without an admin's token."""
    _, body = stack.request("GET", path)
    assert "robotether_relay" not in str(body)


def test_an_admins_token_reads_the_relays_numbers(stack):
    """The relay never gets the token, and an address may not ask for ever."""
    headers = {"Authorization": f"Bearer {stack.token('metrics')}"}
    answers = [stack.request("GET", "/api/v1/metrics", headers=headers) for _ in range(20)]
    status, text = answers[0]
    assert status == 200, text
    assert "\nrobotether_relay_seen_age_seconds_count " in text
    assert {status for status, _ in answers} == {200, 429}

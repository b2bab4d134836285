"""Why something did not answer, in words that a person can use: each fault is made, and has a sentence of its own."""

from __future__ import annotations

import asyncio
import errno
import re
import socket
import ssl
import struct
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, suppress
from datetime import datetime, timedelta, timezone
from ipaddress import ip_address
from pathlib import Path

import aiohttp
import pytest
from aiohttp.client_reqrep import ConnectionKey
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID
from fake_proxy import FakeProxy
from robotether_agent.describe_error import BY_ERRNO, UNKNOWN, cause_of, describe_error

# What no person can use: a class, an object, an address in memory.
FOREIGN = re.compile(r"0x[0-9a-f]|<|\bobject at\b|\w(?:Error|Exception)\b|\.py\b|_ssl|\w\(['\"]")
NASTY = "<aiohttp.Fingerprint object at 0x7f12> ValueError('x') (_ssl.c:1007)"
NOW = datetime.now(timezone.utc)
Talk = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (asyncio.TimeoutError(), "no answer in 4 s"),
        (OSError(errno.ECONNREFUSED, "Connect call failed ('127.0.0.1', 1)"), "Connection refused"),
        (
            OSError(errno.ETIMEDOUT, "timed out"),
            "the connection fell silent (Connection timed out)",
        ),
        (OSError(errno.EMFILE, "x"), "this program has too many files and connections open"),
        (MemoryError(), "this machine has no memory left"),
        (
            OSError("Multiple exceptions: [Errno 111] ('::1', 1), [Errno 101] ('1.2.3.4', 1)"),
            "Connection refused, or no route leads there (Network is unreachable)",
        ),
        (ssl.SSLError(1, "[SSL: WRONG_VERSION_NUMBER] x"), "does not speak TLS (WRONG_VERSION_NUM"),
        (socket.gaierror(-2, "x"), "no name service knows this name (Name or service not known)"),
        (socket.gaierror(-3, "x"), "no name service answers"),
        (ConnectionResetError(), "it cuts the connection"),
        (UnicodeDecodeError("utf-8", b"\xff", 0, 1, "x"), "is no text"),
        (ValueError("first\nsecond"), UNKNOWN.sentence),
    ],
)
def test_each_reason_is_short_and_on_one_line(error, told):
    """The number of another library is not taken for the system's."""
    assert told in describe_error(error, 4)
    assert "\n" not in describe_error(error, 4)


def subclasses(kind: type) -> Iterator[type]:
    yield kind
    for child in kind.__subclasses__():
        yield from subclasses(child)


def built(kind: type[BaseException]) -> Iterator[BaseException]:
    """Give this exception as its library makes it, with a text that must not get through."""
    key = ConnectionKey(
        "robots.example", 443, True, aiohttp.Fingerprint(bytes(32)), None, None, None
    )
    request = aiohttp.RequestInfo("http://a", "GET", {}, "http://a")
    if issubclass(kind, aiohttp.ClientConnectorError):
        path = ["/a"] if kind.__name__.startswith("Unix") else []
        yield kind(*path, key, OSError(NASTY))
        return
    if issubclass(kind, aiohttp.ClientConnectorCertificateError):
        yield kind(key, ssl.SSLCertVerificationError(1, NASTY))
        return
    ways: list[Callable[[], BaseException]] = [
        lambda: kind(key, ssl.SSLError(1, NASTY)),
        lambda: kind(request, (), message=NASTY),
        lambda: kind(1, NASTY),
        lambda: kind(NASTY),
        lambda: kind("utf-8", b"\xff", 0, 1, NASTY),
        lambda: kind("utf-8", "x", 0, 1, NASTY),
        lambda: kind("x", 0, 1, NASTY),
        lambda: kind("a", 1, NASTY),
        lambda: kind(b"a", b"b", "c", 1),
        kind,
    ]
    made = []
    for way in ways:
        with suppress(TypeError, AttributeError):
            made.append(way())
    assert made, f"no way to make {kind}"
    yield from made
    if issubclass(kind, OSError):
        yield from (kind(number, NASTY) for number in errno.errorcode)


ROOTS = (aiohttp.ClientError, aiohttp.WebSocketError, OSError, ValueError, EOFError, RuntimeError)
KINDS = sorted(
    {
        kind
        for root in (*ROOTS, asyncio.TimeoutError, MemoryError)
        for kind in subclasses(root)
        if kind.__module__.partition(".")[0] in {"builtins", "ssl", "socket", "asyncio", "aiohttp"}
    },
    key=str,
)


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_of_python_stands_in_a_reason(kind):
    """Whatever a library raises: no class, no object, no address and no text of its own reaches a person."""
    for error in built(kind):
        cause = cause_of(error, 4)
        assert cause.sentence
        for text in (cause.sentence, cause.advice):
            assert not FOREIGN.search(text), f"{error!r} is told as {text}"
            assert NASTY not in text


async def test_proxys_password_is_not_told():
    """The text of aiohttp has the proxy's URL."""
    async with FakeProxy("refuses") as proxy, aiohttp.ClientSession() as http:
        url = proxy.url.replace("//", "//ann:s3cret@")
        with pytest.raises(aiohttp.ClientHttpProxyError) as refused:
            await http.get("https://robots.example/", proxy=url)
    assert describe_error(refused.value, 4) == "the HTTP proxy answers 403 Forbidden"


class Issuer:
    """An authority of the test's own, and what it signs."""

    def __init__(
        self, place: Path, name: str = "it", *, is_ca: bool = True, has_key_id: bool = True
    ) -> None:
        self._place = place
        self._key = ec.generate_private_key(ec.SECP256R1())
        self._has_key_id = has_key_id
        self._name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
        usual = x509.BasicConstraints(ca=is_ca, path_length=None)
        self.file = self._write("ca", self._made(self._name, self._key, (usual, True)), self._key)

    def server(
        self, name: str = "localhost", begin: timedelta = timedelta(), *, sends: bool = False
    ) -> Path:
        """Make a certificate for a server; with the authority's own behind it, if it `sends` that."""
        key = ec.generate_private_key(ec.SECP256R1())
        names = [x509.DNSName(name), x509.IPAddress(ip_address("127.0.0.9"))]
        made = self._made(
            x509.Name([]), key, (x509.SubjectAlternativeName(names), True), begin=begin
        )
        file = self._write("server", made, key)
        if sends:
            file.write_bytes(file.read_bytes() + self.file.read_bytes())
        return file

    def _made(
        self,
        subject: x509.Name,
        key: ec.EllipticCurvePrivateKey,
        extension: tuple[x509.ExtensionType, bool],
        begin: timedelta = timedelta(),
    ) -> x509.Certificate:
        dates = (NOW + begin - timedelta(days=1), NOW + begin + timedelta(days=1))
        made = x509.CertificateBuilder(
            self._name, subject, key.public_key(), x509.random_serial_number(), *dates
        ).add_extension(*extension)
        if self._has_key_id:
            known = x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key())
            made = made.add_extension(known, critical=False)
        return made.sign(self._key, hashes.SHA256())

    def _write(self, name: str, made: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> Path:
        file = self._place / f"{name}-{made.serial_number}.pem"
        secret = key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        )
        file.write_bytes(secret + made.public_bytes(serialization.Encoding.PEM))
        return file


@asynccontextmanager
async def serving(talk: Talk, pem: Path | None = None) -> AsyncIterator[int]:
    """Serve on a port of localhost, over TLS with this certificate if there is one."""
    context = None
    if pem is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(pem)
    server = await asyncio.start_server(talk, "127.0.0.1", 0, ssl=context)
    async with server:
        yield server.sockets[0].getsockname()[1]


async def greet(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    writer.write(b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\nok")
    writer.close()


async def reset(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    connection = writer.get_extra_info("socket")
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    writer.transport.abort()


def saying(words: bytes) -> Talk:
    async def say(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(1)
        writer.write(words)
        writer.close()

    return say


async def _get(url: str, context: ssl.SSLContext | None) -> None:
    async with aiohttp.ClientSession() as http, http.get(url, ssl=context or True) as answer:
        await answer.read()


async def told(port: int, context: ssl.SSLContext | None = None) -> str:
    """Return what is made of an attempt to get a page there."""
    scheme = "http" if context is None else "https"
    url = f"{scheme}://localhost:{port}/"
    with pytest.raises((aiohttp.ClientError, OSError, asyncio.TimeoutError)) as caught:
        await asyncio.wait_for(_get(url, context), 9)
    sentence = describe_error(caught.value, 9)
    assert not FOREIGN.search(sentence), sentence
    return sentence


def trusting(issuer: Issuer | None = None) -> ssl.SSLContext:
    return ssl.create_default_context(cafile=issuer and issuer.file)


async def test_each_fault_of_a_certificate_has_its_sentence(place):
    """Whatever OpenSSL refuses is told by what is wrong with the certificate, and not by its own words."""
    issuer, other = Issuer(place), Issuer(place, "another")
    late, early = timedelta(days=-9), timedelta(days=9)
    strict = trusting(bare := Issuer(place, has_key_id=False))
    # As Python does by itself from 3.13 on.
    strict.verify_flags |= ssl.VERIFY_X509_STRICT
    no_ca = Issuer(place, is_ca=False)
    cases = [
        (issuer.server(begin=late), trusting(issuer), "it has expired"),
        (issuer.server(begin=early), trusting(issuer), "it is not yet valid"),
        (issuer.server("other.example"), trusting(issuer), "it is for another name"),
        (issuer.file, trusting(other), "it is self-signed"),
        (issuer.server(sends=True), trusting(other), "its chain ends in an authority"),
        (issuer.server(), trusting(other), "this robot does not know its authority"),
        (issuer.server(), trusting(Issuer(place)), "a signature in its chain is wrong"),
        (no_ca.server(), trusting(no_ca), "may not be used like that"),
        (bare.server(), strict, "OpenSSL's strict rules, which Python has from 3.13 on"),
    ]
    for pem, context, words in cases:
        async with serving(greet, pem) as port:
            assert words in await told(port, context)


def shaken(pem: Path, client: ssl.SSLContext, **of_server: object) -> str:
    """Return what is made of a handshake with a server of this kind, without a network that may cut it first."""
    server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    server.load_cert_chain(pem)
    for name, value in of_server.items():
        setattr(server, name, value)
    here, there = ssl.MemoryBIO(), ssl.MemoryBIO()
    ends = [
        client.wrap_bio(there, here, server_hostname="localhost"),
        server.wrap_bio(here, there, server_side=True),
    ]
    for _ in range(4):
        with suppress(ssl.SSLWantReadError):
            try:
                ends[0].do_handshake()
                ends[0].read(1)
            except ssl.SSLWantReadError:
                raise
            except ssl.SSLError as error:
                return describe_error(error, 9)
        with suppress(ssl.SSLError):
            ends[1].do_handshake()
    raise AssertionError("the handshake is well")


async def test_each_fault_of_a_handshake_has_its_sentence(place):
    """TLS that is of another kind, is cut, or is none at all."""
    issuer = Issuer(place)
    pem, modern, frugal = issuer.server(), trusting(issuer), trusting(issuer)
    modern.minimum_version = ssl.TLSVersion.TLSv1_3
    frugal.maximum_version = ssl.TLSVersion.TLSv1_2
    # A cipher for certificates of RSA, which this one is not.
    frugal.set_ciphers("ECDHE-RSA-AES128-GCM-SHA256")
    old = ssl.TLSVersion.TLSv1_2
    assert "no version of TLS that" in shaken(pem, modern, maximum_version=old)
    assert "no cipher that this robot accepts" in shaken(pem, frugal)
    wants = shaken(pem, trusting(issuer), verify_mode=ssl.CERT_REQUIRED)
    assert "it wants a client's certificate" in wants
    for talk, words in (
        (saying(b"HTTP/1.1 302 Found\r\n\r\n"), "does not speak TLS"),
        (saying(b""), "it cuts the connection"),
        (reset, "it cuts the connection"),
    ):
        async with serving(talk) as port:
            assert words in await told(port, trusting())


async def test_each_fault_of_an_answer_has_its_sentence():
    """What comes back may be none, half, or of another language."""
    half = b"HTTP/1.1 200 OK\r\nContent-Length: 9\r\n\r\nhalf"
    cases = [
        (saying(b""), "closes the connection without an answer"),
        (saying(half), "its answer is cut short"),
        (saying(b"SSH-2.0-OpenSSH_9.2\r\n"), "what it answers is not HTTP"),
    ]
    for talk, words in cases:
        async with serving(talk) as port:
            assert words in await told(port)


def test_faults_that_are_not_the_servers_come_with_their_advice():
    """Who cannot reach a name service is not sent to the server's firewall."""
    for number in (errno.ENETUNREACH, errno.EHOSTUNREACH, errno.EMFILE, errno.ENOMEM, errno.EPERM):
        advice = cause_of(OSError(number, NASTY), 4).advice
        assert advice == BY_ERRNO[number].advice != ""
    assert "name service" in cause_of(socket.gaierror(socket.EAI_AGAIN, NASTY), 4).advice

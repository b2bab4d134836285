"""Problems: one tree, with codes that are each used once."""

import builtins
import re
import ssl
from pathlib import Path
from types import SimpleNamespace

import aiohttp
import pytest
from robotether_server import problems
from robotether_server.problems import RobotetherError, reason_in


def tree(kind):
    return [kind, *(below for child in kind.__subclasses__() for below in tree(child))]


OURS = [kind for kind in tree(RobotetherError) if kind.__module__ == problems.__name__]


def test_codes_are_unique():
    codes = [kind.code for kind in OURS if "code" in vars(kind)]
    assert len(codes) == len(set(codes)) > 1


def test_every_exception_of_the_server_is_in_the_tree():
    """Each has a sentence for people, and a code or one from above."""
    texts = [path.read_text("utf-8") for path in Path(problems.__file__).parent.rglob("*.py")]
    classes = [found for text in texts for found in re.findall(r"^class (\w+)\((\w+)", text, re.M)]
    roots = [
        name
        for name, base in classes
        if base.endswith(("Error", "Exception")) and hasattr(builtins, base)
    ]
    assert roots == ["RobotetherError"]


# What aiohttp raises, whose text names the object that holds the certificates.
REFUSED = aiohttp.ClientConnectorError(
    SimpleNamespace(host="host", port=1, ssl=ssl.create_default_context()),
    OSError(111, "Connect call failed ('192.0.2.1', 1)"),
)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (FileNotFoundError(2, "No such file or directory", "/secret/path"), "No such file"),
        (ssl.SSLError(1, "[SSL: WRONG_VERSION_NUMBER] x (_ssl.c:1007)"), "TLS fails"),
        (REFUSED, "Connection refused"),
        (aiohttp.WSServerHandshakeError(None, (), status=403), "HTTP 403"),
        (TimeoutError(), "no answer in time"),
        (UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid start byte"), "it is not text"),
        (ZeroDivisionError("<object at 0x7f12>"), "no reason is known"),
    ],
)
def test_reasons_hold_nothing_of_python(error, words):
    reason = reason_in(error)
    assert words in reason
    assert not re.search(r"0x|<|Error|_ssl|Errno|/secret", reason)

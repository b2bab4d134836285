"""Decides which headers, destinations and content types pass between a viewer and a robot's video.

`video` asks for each request. What a robot answers comes from this site's own address, so it must
not be able to act as a part of the site: no script, style, frame of another kind, cookie or upgrade.
Pure.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping

from multidict import CIMultiDict

from robotether_server.problems import DestinationRefusedError

REQUEST_HEADERS = (
    "Accept",
    "Accept-Encoding",
    "Accept-Language",
    "If-Modified-Since",
    "If-None-Match",
    "Range",
    "User-Agent",
)
RESPONSE_HEADERS = (
    "Accept-Ranges",
    "Cache-Control",
    "Content-Disposition",
    "Content-Encoding",
    "Content-Length",
    "Content-Range",
    "Content-Type",
    "ETag",
    "Expires",
    "Last-Modified",
    "Pragma",
    "X-Timestamp",
)
OUR_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Content-Security-Policy": "sandbox",
    "Referrer-Policy": "no-referrer",
}
# Nobody stores a live frame: a browser that asks for it again gets another one.
LIVE_HEADERS = {"Cache-Control": "no-store", "Pragma": "no-cache"}
# What a browser may want the answer for: to show it, or to hand it to a page's script as data.
# The pages allow scripts and styles of their own site, which a robot must not be.
DESTINATIONS = frozenset({"document", "empty", "frame", "iframe", "image", "video"})
# Where a browser shows a document. Some take each part of a multipart answer for one, with headers of its own.
OF_DOCUMENTS = frozenset({"document", "frame", "iframe"})
MULTIPART = "multipart/"
# No comma: browsers take the last type of a list.
PASSING_TYPE = re.compile(
    r"(image/[a-z0-9.+-]+|video/[a-z0-9.+-]+|multipart/x-mixed-replace"
    r"|text/html|text/plain|application/json)\s*(;[^,]*)?",
    re.IGNORECASE | re.ASCII,
)
UNKNOWN_TYPE = {"Content-Type": "application/octet-stream", "Content-Disposition": "attachment"}


def check_destination(headers: Mapping[str, str]) -> None:
    """Raise DestinationRefusedError when a browser would run or apply the answer."""
    destination = headers.get("Sec-Fetch-Dest", "empty")
    if destination not in DESTINATIONS:
        raise DestinationRefusedError(
            f"cannot show video as {destination[:32]!r}: what a robot sends never becomes part of a page"
        )


def headers_for_robot(headers: Mapping[str, str]) -> CIMultiDict[str]:
    """Keep what helps the robot to answer; nothing that shows who asks, and no upgrade."""
    return _passing(headers, REQUEST_HEADERS)


def headers_of_stream(*, embeddable: bool) -> dict[str, str]:
    """Return the headers of a stream that the relay itself writes."""
    return {**LIVE_HEADERS, **_our_headers(embeddable=embeddable)}


def headers_for_viewer(
    headers: Mapping[str, str], *, embeddable: bool = False, destination: str = "empty"
) -> CIMultiDict[str]:
    """Keep what describes the body; nothing that could act on our site.

    Raises DestinationRefusedError for the robot's own multipart answer where a document is shown.
    """
    response_headers = _passing(headers, RESPONSE_HEADERS)
    is_multipart = response_headers.get("Content-Type", "").strip().lower().startswith(MULTIPART)
    if is_multipart and destination in OF_DOCUMENTS:
        raise DestinationRefusedError(
            f"cannot show this stream as {destination!r}: show it as an image of a page"
        )
    if not PASSING_TYPE.fullmatch(response_headers.get("Content-Type", "")):
        response_headers.update(UNKNOWN_TYPE)
    response_headers.update(_our_headers(embeddable=embeddable))
    return response_headers


def _passing(headers: Mapping[str, str], names: Collection[str]) -> CIMultiDict[str]:
    """Keep these headers; but none that cannot be written again: bytes over 0x7F and control characters."""
    pairs = ((name, headers[name]) for name in names if name in headers)
    return CIMultiDict(
        (name, text) for name, text in pairs if text.isascii() and text.isprintable()
    )


def _our_headers(*, embeddable: bool) -> dict[str, str]:
    """Keep the answer apart from our site; whether pages of others may show it hangs on who asked how."""
    policy = "cross-origin" if embeddable else "same-origin"
    return {**OUR_HEADERS, "Cross-Origin-Resource-Policy": policy}

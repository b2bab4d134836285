"""What passes between a viewer and a robot's web server, header by header."""

import pytest
from robotether_server.problems import DestinationRefusedError
from robotether_server.relay.channels.video.headers import (
    check_destination,
    headers_for_robot,
    headers_for_viewer,
)


@pytest.mark.parametrize("destination", ["image", "video", "empty", "document", "iframe", "frame"])
def test_what_shows_a_picture_may_have_it(destination):
    check_destination({"Sec-Fetch-Dest": destination})


@pytest.mark.parametrize("destination", ["document", "frame", "iframe"])
@pytest.mark.parametrize("kind", ["multipart/x-mixed-replace;boundary=b", " Multipart/mixed"])
def test_a_robots_parts_are_no_documents(destination, kind):
    """Each could be a page with headers of its own."""
    with pytest.raises(DestinationRefusedError):
        headers_for_viewer({"Content-Type": kind}, destination=destination)
    assert headers_for_viewer({"Content-Type": "image/jpeg"}, destination=destination)
    assert headers_for_viewer({"Content-Type": kind}, destination="image")


@pytest.mark.parametrize(
    "destination",
    ["script", "worker", "sharedworker", "serviceworker", "style", "object", "embed", "json", "xslt",
     "audioworklet", "paintworklet", "manifest", "Script", "a word of tomorrow", ""],
)  # fmt: skip
def test_what_would_run_or_apply_it_may_not(destination):
    with pytest.raises(DestinationRefusedError):
        check_destination({"Sec-Fetch-Dest": destination})


@pytest.mark.parametrize(
    "content_type",
    ["image/jpeg", "image/svg+xml", "video/webm", "multipart/x-mixed-replace;boundary=--frame",
     "multipart/x-mixed-replace; boundary=frame", "text/html; charset=utf-8", "text/plain",
     "application/json", "Image/PNG"],
)  # fmt: skip
def test_pictures_and_plain_pages_keep_their_type(content_type):
    headers = headers_for_viewer({"Content-Type": content_type})
    assert headers["Content-Type"] == content_type
    assert "Content-Disposition" not in headers


@pytest.mark.parametrize(
    "content_type",
    ["text/javascript", "application/javascript", "text/css", "application/wasm", "text/xml",
     "application/pdf", "application/xhtml+xml", "multipart/mixed", "image/png, text/javascript",
     "image/png; a=b, text/javascript", "image/png text/javascript", "image/", "text/htmlx", "",
     None],
)  # fmt: skip
def test_any_other_type_is_a_file_to_be_saved(content_type):
    sent = {"Content-Disposition": "inline; filename=a.js"}
    headers = headers_for_viewer(
        sent | ({} if content_type is None else {"Content-Type": content_type})
    )
    assert headers.getall("Content-Type") == ["application/octet-stream"]
    assert headers.getall("Content-Disposition") == ["attachment"]


@pytest.mark.parametrize("text", ["\udcff", "a\x01b", "caf\xe9", "a\x7f"])
def test_header_that_cannot_be_written_again_is_dropped(text):
    sent = {"ETag": text, "X-Timestamp": "12.5", "Content-Type": "image/jpeg"}
    assert "ETag" not in headers_for_viewer(sent)
    assert headers_for_viewer(sent)["X-Timestamp"] == "12.5"
    assert dict(headers_for_robot({"User-Agent": text, "Accept": "*/*"})) == {"Accept": "*/*"}


def test_every_answer_is_shut_in():
    sent = {"Content-Security-Policy": "script-src *", "Location": "/", "Set-Cookie": "a=b"}
    headers = headers_for_viewer(sent | {"Access-Control-Allow-Origin": "*"})
    assert headers["Content-Security-Policy"] == "sandbox"
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert not {"Location", "Set-Cookie", "Access-Control-Allow-Origin"} & set(headers)

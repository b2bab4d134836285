"""A double of an RTSP camera, over TCP alone.

Modes: `streams` H.264; `silent` plays and sends nothing; `refuses` wants a login; `redirects` leads to `location`;
`describes` has a description that leads there; `audio` has a microphone alone.
"""

from __future__ import annotations

import asyncio
import base64
import struct
from contextlib import suppress
from typing import Literal

from robotether_agent.video.encoder_messages import EncodeRequest
from robotether_agent.video.encoder_process import FrameTranscoder
from robotether_common.codecs import H264

RtspMode = Literal["streams", "silent", "refuses", "redirects", "describes", "audio"]
FPS = 15
RTP = struct.Struct("!BBHII")
CLOCK = 90_000
SPS, PPS = 7, 8


def units_of(data: bytes) -> list[bytes]:
    """Return the NAL units of an access unit in Annex B."""
    return [unit.rstrip(b"\0") for unit in data.split(b"\0\0\1")[1:]]


class FakeRtspCamera:
    def __init__(self, jpegs: list[bytes], mode: RtspMode = "streams", location: str = "") -> None:
        transcoder = FrameTranscoder()
        self.units = [
            units_of(transcoder.encode(EncodeRequest(jpeg, H264, 320, 240, 800_000, FPS)).data)
            for jpeg in jpegs
        ]
        self.mode = mode
        self.location = location
        self.requests: list[str] = []

    async def __aenter__(self) -> FakeRtspCamera:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.url = f"rtsp://me:secret@127.0.0.1:{self._server.sockets[0].getsockname()[1]}/video"
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        await self._server.wait_closed()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        playing: asyncio.Future[None] | None = None
        with suppress(ConnectionError, asyncio.IncompleteReadError):
            while True:
                request = (await reader.readuntil(b"\r\n\r\n")).decode()
                method = request.split(" ")[0]
                self.requests.append(method)
                writer.write(self._answer(method, request))
                if method == "PLAY" and self.mode == "streams":
                    playing = asyncio.ensure_future(self._play(writer))
        if playing is not None:
            playing.cancel()
            await asyncio.gather(playing, return_exceptions=True)
        writer.close()

    def _answer(self, method: str, request: str) -> bytes:
        number = request.lower().split("cseq: ")[1].split("\r\n")[0]
        status, head, body = "200 OK", "", ""
        if self.mode == "refuses" and method != "OPTIONS":
            status, head = "401 Unauthorized", 'WWW-Authenticate: Basic realm="x"\r\n'
        elif method == "OPTIONS":
            head = "Public: DESCRIBE, SETUP, PLAY, TEARDOWN\r\n"
        elif method == "DESCRIBE" and self.mode == "redirects":
            status, head = "302 Found", f"Location: {self.location}\r\n"
        elif method == "DESCRIBE":
            body = self._description()
            head = f"Content-Type: application/sdp\r\nContent-Length: {len(body)}\r\n"
        elif method == "SETUP":
            head = "Transport: RTP/AVP/TCP;unicast;interleaved=0-1\r\n"
        return f"RTSP/1.0 {status}\r\nCSeq: {number}\r\nSession: 1\r\n{head}\r\n{body}".encode()

    def _description(self) -> str:
        if self.mode == "audio":
            return "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=x\r\nt=0 0\r\nm=audio 0 RTP/AVP 0\r\na=control:track1\r\n"
        sets = [unit for unit in self.units[0] if unit[0] & 31 in (SPS, PPS)]
        sprop = ",".join(base64.b64encode(unit).decode() for unit in sets)
        control = self.location if self.mode == "describes" else "track1"
        return (
            "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=x\r\nt=0 0\r\nm=video 0 RTP/AVP 96\r\n"
            f"a=rtpmap:96 H264/{CLOCK}\r\n"
            f"a=fmtp:96 packetization-mode=1;sprop-parameter-sets={sprop}\r\na=control:{control}\r\n"
        )

    async def _play(self, writer: asyncio.StreamWriter) -> None:
        sequence = number = 0
        while True:
            units = self.units[number % len(self.units)]
            for unit in units:
                marker = 0x80 if unit is units[-1] else 0
                packet = RTP.pack(
                    0x80, 96 | marker, sequence % 65536, number * CLOCK // FPS % 2**32, 1
                )
                writer.write(b"$\0" + struct.pack("!H", len(packet) + len(unit)) + packet + unit)
                sequence += 1
            number += 1
            await asyncio.sleep(1 / FPS)

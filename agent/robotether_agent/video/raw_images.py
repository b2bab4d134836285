"""Raw images of ROS (sensor_msgs/Image) as PyAV's frames; what shows distances becomes grey.

A robot's node writes these messages, so no number in one is trusted. Run by `image_process`.
"""

from __future__ import annotations

import binascii
from dataclasses import dataclass
from typing import Any

import av
from av.filter import Graph
from robotether_common.frames import MAX_SIDE

from robotether_agent.fields import FieldError, JsonObject, get_int, get_text, printable
from robotether_agent.video.av_program import FULL, LIMITED
from robotether_agent.video.newest_jpegs import CameraFailedError

# FFmpeg's pixel formats by encoding, and the bytes a pixel; those of distances have none.
FORMATS = {
    "rgb8": ("rgb24", 3),
    "bgr8": ("bgr24", 3),
    "rgba8": ("rgba", 4),
    "bgra8": ("bgra", 4),
    "mono8": ("gray", 1),
    "mono16": ("gray16", 2),
    # As OpenCV orders them, whose bridge calls images so where nobody names an encoding.
    "8UC1": ("gray", 1),
    "8UC3": ("bgr24", 3),
    "8UC4": ("bgra", 4),
    # As webcams give it, of which usb_cam and camera_ros publish it so; the newer names are the same.
    "yuv422": ("uyvy422", 2),
    "uyvy": ("uyvy422", 2),
    "yuv422_yuy2": ("yuyv422", 2),
    "yuyv": ("yuyv422", 2),
    **{
        f"bayer_{colours}8": (f"bayer_{colours}8", 1)
        for colours in ("rggb", "bggr", "gbrg", "grbg")
    },
    "16UC1": ("", 2),
    "32FC1": ("", 4),
}
# Maximum distance in m that is told from farther ones, and the greys of the nearest and of that (REP 118: mm and m).
RANGE_M, NEAR_GREY, FAR_GREY = 10, 255, 32
# Each grey as FFmpeg computes it of 16 bits, for a table of all values. 0 is unknown and stays black. Of a float these
# are its upper ones: sign, exponent and 7 bits, which are exact to a part in 128; those of NaN and of less than nothing
# stay black.
_GREY = f"257*({NEAR_GREY}-({NEAR_GREY - FAR_GREY})*min(1,{{part}}))"
_MILLIMETRES = "if(val," + _GREY.format(part=f"val/{1000 * RANGE_M}") + ",0)"
_METRES = f"pow(2,floor(val/128)-127)*(1+mod(val,128)/128)/{RANGE_M}"
_FLOATS = "if(val*lte(val,32640)," + _GREY.format(part=_METRES) + ",0)"
GREYS = {"16UC1": _MILLIMETRES, "32FC1": _FLOATS}


@dataclass(frozen=True)
class RawImage:
    """One image; `data` has `height` rows of `step` bytes, the last one may be shorter."""

    width: int
    height: int
    step: int
    encoding: str
    is_big_endian: bool
    data: bytes

    @classmethod
    def of(cls, message: JsonObject) -> RawImage:
        """Return the image of rosbridge's message; CameraFailedError for what is none, or cannot be shown."""
        try:
            encoding = get_text(message, "encoding", limit=40)
            if encoding not in FORMATS:
                raise CameraFailedError(
                    f"its images have the encoding {printable(encoding, 40)}, which is not shown"
                )
            width, height = (get_int(message, side, 1, MAX_SIDE) for side in ("width", "height"))
            row = width * FORMATS[encoding][1]
            step = get_int(message, "step", row, 2**31)
            data = binascii.a2b_base64(message.get("data", ""))  # type: ignore[arg-type]
        except FieldError as error:
            raise CameraFailedError(f"its images make no sense: {error}") from error
        except (TypeError, ValueError) as error:
            raise CameraFailedError("its images make no sense") from error
        if len(data) < step * (height - 1) + row:
            raise CameraFailedError("its images have less data than their size")
        return cls(width, height, step, encoding, bool(message.get("is_bigendian")), data)

    @property
    def pixels(self) -> bytes:
        """The rows without what is between them."""
        row, step = self.width * FORMATS[self.encoding][1], self.step
        if step == row:
            return self.data[: row * self.height]
        return b"".join(self.data[at : at + row] for at in range(0, step * self.height, step))


class FrameMaker:
    """Makes PyAV's frames of a topic's images."""

    def __init__(self) -> None:
        self._greys: Any = None
        self._greys_of: tuple[int, int, str] | None = None

    def frame(self, image: RawImage) -> Any:
        """Return an image as a frame."""
        endian = "be" if image.is_big_endian else "le"
        if image.encoding == "32FC1":
            return self._grey_frame(image, _upper_halves(image), "le")
        if image.encoding in GREYS:
            return self._grey_frame(image, image.pixels, endian)
        pixel_format, _ = FORMATS[image.encoding]
        frame = _frame_of(image, pixel_format + endian * (pixel_format == "gray16"), image.pixels)
        # FFmpeg's way from there to JPEG's colours makes them darker.
        return frame.reformat(format="rgb24") if pixel_format.startswith("bayer") else frame

    def _grey_frame(self, image: RawImage, pixels: bytes, endian: str) -> Any:
        frame = _frame_of(image, f"gray16{endian}", pixels)
        if endian == "be":
            frame = frame.reformat(format="gray16le", src_color_range=FULL, dst_color_range=FULL)
        graph = self._graph(image)
        graph.push(frame)
        return graph.pull()

    def _graph(self, image: RawImage) -> Any:
        kind = (image.width, image.height, image.encoding)
        if self._greys is None or self._greys_of != kind:
            self._greys, self._greys_of = _graph_of(*kind), kind
        return self._greys


def _frame_of(image: RawImage, pixel_format: str, pixels: bytes) -> Any:
    frame: Any = av.VideoFrame(image.width, image.height, pixel_format)
    frame.color_range, frame.pts = LIMITED if "422" in pixel_format else FULL, 0
    (plane,) = frame.planes
    row, line = len(pixels) // image.height, plane.line_size
    if row != line:
        starts = range(0, len(pixels), row)
        pixels = b"".join(pixels[at : at + row].ljust(line, b"\0") for at in starts)
    plane.update(pixels.ljust(plane.buffer_size, b"\0"))
    return frame


def _upper_halves(image: RawImage) -> bytes:
    """Return the upper 16 bits of each of 32, little-endian."""
    pixels = image.pixels
    halves = bytearray(len(pixels) // 2)
    high, low = (0, 1) if image.is_big_endian else (3, 2)
    halves[0::2], halves[1::2] = pixels[low::4], pixels[high::4]
    return bytes(halves)


def _graph_of(width: int, height: int, encoding: str) -> Any:
    graph: Any = Graph()
    size = f"video_size={width}x{height}:pix_fmt=gray16le:time_base=1/1000:range=pc"
    nodes = [
        graph.add("buffer", size),
        graph.add("lut", f"c0='{GREYS[encoding]}'"),
        graph.add("buffersink"),
    ]
    graph.link_nodes(*nodes).configure()
    return graph

"""What a frame says of itself."""

from __future__ import annotations

import io

import pytest
from fake_cameras import fake_jpeg
from PIL import Image
from robotether_agent.video.frame import jpeg_size


@pytest.mark.parametrize("progressive", [False, True])
def test_the_size_of_a_real_jpeg(progressive):
    """Baseline and progressive, with the tables that stand before."""
    file = io.BytesIO()
    Image.new("RGB", (322, 98)).save(file, "JPEG", progressive=progressive, comment=b"x" * 300)
    assert jpeg_size(file.getvalue()) == (322, 98)


def test_what_is_cut_off_or_no_jpeg_has_none():
    whole = fake_jpeg(1, size=(640, 480))
    assert jpeg_size(whole) == (640, 480)
    assert [jpeg_size(whole[:length]) for length in range(16)] == [None] * 16
    assert jpeg_size(b"\x89PNG" + bytes(100)) is None

"""What the map's canvas of the drive page shows, by the colours of mapTile.js and world.js."""

from __future__ import annotations

from playwright.sync_api import Locator

Colour = tuple[int, int, int]
SCAN: Colour = (255, 107, 107)
WALL: Colour = (236, 240, 246)

FIND = """(canvas, [red, green, blue]) => {
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  const found = [];
  for (let i = 0; i < data.length; i += 4)
    if (Math.abs(data[i] - red) + Math.abs(data[i + 1] - green) + Math.abs(data[i + 2] - blue) < 24)
      found.push([(i / 4) % canvas.width, Math.floor(i / 4 / canvas.width)]);
  return found;
}"""


def find_pixels(canvas: Locator, colour: Colour) -> set[tuple[int, int]]:
    return {(x, y) for x, y in canvas.evaluate(FIND, list(colour))}


def wait_pixels(canvas: Locator, colour: Colour, least: int, most: float = 1e9) -> None:
    canvas.page.wait_for_function(
        f"([canvas, colour, least, most]) => {{ const count = ({FIND})(canvas, colour).length;"
        " return least <= count && count <= most; }",
        arg=[canvas.element_handle(), list(colour), least, most],
        timeout=10_000,
    )

"""Figures come out the same for the same values."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure
from paper.figures import write
from paper.step import Plot


def draw(drawing: Figure) -> None:
    axes = drawing.subplots()
    axes.plot([0, 1, 2], [0, 1, 4], label="x² < 5")
    axes.legend()


def test_same_values_give_the_same_file(tmp_path: Path) -> None:
    """No date, no random ids: a page that is written again is no change in git."""
    plot = Plot(name="a_curve", caption="A curve", draw=draw)
    (tmp_path / "again").mkdir()
    first, second = write(tmp_path, plot), write(tmp_path / "again", plot)
    assert first.name == "a-curve.svg"
    assert first.read_bytes() == second.read_bytes()
    assert "<dc:date>" not in first.read_text()


def test_figure_is_white_behind(tmp_path: Path) -> None:
    """Black letters can be read on a dark page, too."""
    path = write(tmp_path, Plot(name="white", caption="White", draw=draw))
    assert "fill: #ffffff" in path.read_text()

"""The page's figures as SVG: the same values give the same file, whenever and wherever they are drawn."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from paper.step import Plot

SIZE_INCHES = (8.0, 4.5)
# White behind everything, for pages that are dark; ids that do not differ from one drawing to the next.
STYLE = {
    "svg.hashsalt": "robotether",
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "font.size": 10,
}


def file_name(plot: Plot) -> str:
    """`spiral-fixed.svg`."""
    return f"{plot.name.replace('_', '-')}.svg"


def write(folder: Path, plot: Plot) -> Path:
    """Draw it and return where it is; `plot.draw` may change the figure's size."""
    path = folder / file_name(plot)
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=SIZE_INCHES, layout="constrained")
        plot.draw(drawing)
        canvas = FigureCanvasSVG(drawing)
        canvas.print_svg(path, metadata={"Date": None, "Creator": None})
    return path

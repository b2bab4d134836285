"""The operators' figures are drawn of whatever there is."""

from __future__ import annotations

from pathlib import Path

from paper import figures
from paper.operators_plan import ADAPTIVE, NETWORKS, OURS, PLAIN, QUALITIES
from paper.operators_plots import plots
from paper.operators_values import summary
from seen_robot import seen


def test_figures_of_a_whole_run_name_each_network(tmp_path: Path) -> None:
    """In the legend of both."""
    all_of_it = {
        (network, quality, way): summary([seen()], 1.0)
        for network in NETWORKS
        for quality in QUALITIES
        for way in (OURS, PLAIN)
    }
    drawn = [figures.write(tmp_path, plot).read_text() for plot in plots(all_of_it)]
    assert len(drawn) == 2
    # matplotlib writes texts as shapes, and what they say as comments.
    assert all(f"<!-- {profile.name} -->" in svg for svg in drawn for profile in NETWORKS.values())


def test_figures_of_one_run_are_drawn(tmp_path: Path) -> None:
    """Also where no picture came."""
    few = {("4g-7", 50, OURS): summary([seen(pictures=[], commands_ms=[None])], 1.0)}
    for plot in plots(few):
        assert figures.write(tmp_path, plot).stat().st_size > 1000


def test_there_is_no_figure_without_a_quality() -> None:
    """What is adaptive has no place on the axis."""
    assert not plots({})
    assert not plots({("4g-7", ADAPTIVE, OURS): summary([seen()], 1.0)})

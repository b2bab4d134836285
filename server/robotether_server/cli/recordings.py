"""robotether recording: what becomes of the files of recordings that were downloaded (docs/howto/recordings.md).

It needs no server, and for training data the extra `lerobot`, which the server's image does not have.
"""

from pathlib import Path

import click

from robotether_server.cli.common import NotDoneError, print_fields


@click.group("recording")
def recording() -> None:
    """Work with downloaded recordings."""


@recording.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--lerobot",
    "folder",
    required=True,
    type=click.Path(path_type=Path),
    help="New folder for a LeRobot dataset, version 3.",
)
@click.option(
    "--fps",
    type=click.IntRange(1, 60),
    help="Steps a second.  [default: the median rate of the quickest camera]",
)
@click.option(
    "--camera",
    "cameras",
    multiple=True,
    help="Only this camera; may be repeated.  [default: those that the driver saw]",
)
@click.option(
    "--odometry",
    help="Topic of the robot's odometry.  [default: that of its drive topic's namespace]",
)
@click.option(
    "--task", default="Drive the robot.", show_default=True, help="What the robot was to do."
)
def export(
    files: tuple[Path, ...],
    folder: Path,
    *,
    fps: int | None,
    cameras: tuple[str, ...],
    odometry: str | None,
    task: str,
) -> None:
    """Make one dataset of recorded drives, for training."""
    try:
        from robotether_server.lerobot import export as lerobot  # noqa: PLC0415 - an extra
    except ModuleNotFoundError as error:
        raise NotDoneError(
            f"cannot export: {error.name} is not installed; in a checkout, pip install './server[lerobot]'"
        ) from error
    options = lerobot.ExportOptions(fps, cameras, task, odometry)
    report = lerobot.export(files, folder, options)
    source = "as given" if fps else "the median of the quickest camera"
    print_fields(
        [
            ("episodes", f"{report.episodes}"),
            ("steps", f"{report.steps}, {report.fps} a second ({source})"),
            ("cameras", ", ".join(report.cameras)),
            ("left out", lerobot.describe_cuts(report) or "nothing"),
        ]
    )

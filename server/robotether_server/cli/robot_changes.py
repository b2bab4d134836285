"""robotether robot disable, enable, rename, set-mac, move-ports, shell: what an admin changes of a robot.

A live tunnel follows within 2 s: it is cut, or told of its new settings.
"""

import click

from robotether_server.cli.common import SOURCE, NotDone, open_database
from robotether_server.services import robots

PORT = click.IntRange(1024, 65535)


@click.command()
@click.argument("name")
def disable(name: str) -> None:
    """Keep a robot out, and end its connection.

    Whatever its key, until: enable.
    """
    with open_database().transaction() as tx:
        robots.disable(tx, SOURCE, name)
    click.echo(f"robot {name} is disabled")


@click.command()
@click.argument("name")
def enable(name: str) -> None:
    """Let a disabled robot in again."""
    with open_database().transaction() as tx:
        enabled = robots.enable(tx, SOURCE, name)
    click.echo(f"robot {name} is {enabled.state}")


@click.command()
@click.argument("name")
@click.argument("new_name")
def rename(name: str, new_name: str) -> None:
    """Give a robot another name.

    Grants, ports and its connection stay; its URLs change.
    """
    with open_database().transaction() as tx:
        robots.rename(tx, SOURCE, name, new_name)
    click.echo(f"robot {name} is {new_name} now")


@click.command("set-mac")
@click.argument("name")
@click.argument("mac")
@click.option(
    "--allow-local-mac", is_flag=True, help="Take a MAC that the machine has given itself."
)
def set_mac(name: str, mac: str, allow_local_mac: bool) -> None:
    """Give a robot another MAC."""
    with open_database().transaction() as tx:
        changed = robots.set_mac(tx, SOURCE, name, mac, allow_local_mac=allow_local_mac)
    click.echo(f"robot {name} has MAC {changed.mac}")


@click.command("move-ports")
@click.argument("name")
@click.option("--ros", type=PORT, help="Port for rosbridge, from the server's range.")
@click.option("--video", type=PORT, help="Port for video; goes with --ros.")
def move_ports(name: str, ros: int | None, video: int | None) -> None:
    """Move a robot to other ports.

    Without any, to a pair that is free. The robot connects again.
    """
    if (ros is None) != (video is None):
        raise NotDone(f"cannot move robot {name}: --ros and --video go together")
    with open_database().transaction() as tx:
        moved = robots.move_ports(tx, SOURCE, name, ros, video)
    click.echo(f"robot {name} has ports {moved.ros_port} and {moved.video_port}")


@click.command()
@click.argument("name")
@click.argument("switch", type=click.Choice(("on", "off")))
def shell(name: str, switch: str) -> None:
    """Turn shells on a robot on or off.

    While it is on, people who manage the robot reach its own SSH server. They need an account there, a key in
    their profile here, and: robotether ssh-config.
    """
    with open_database().transaction() as tx:
        changed = robots.set_shell(tx, SOURCE, name, switch == "on")
    where = f", at port {changed.shell_port} of the server" if changed.shell_port else ""
    click.echo(f"the shell of robot {name} is {switch}{where}")

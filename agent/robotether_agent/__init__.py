"""The agent of Robotether: the boot service on a robot that keeps its tunnel to the server open.

systemd starts it as `robotether-agent run`. It must never accept a changed host key, and never lead anybody past its
guard to rosbridge unless the robot's own settings say so.

Imports go one way: what needs nothing here <- net <- enrolment <- tunnel <- connections <- daemon, with
guard and video beside.

    cli              the command `robotether-agent`; `doctor` runs all checks
    daemon           the main loop of `run`: enrols, connects, and keeps guard, video and health going
    connections      those beside the session: video and shell, while the server requests them
    enrolment        who this robot is
    net              how it reaches its server
    tunnel           one SSH connection and its session
    guard            what stops the robot, a process of its own, and what keeps it running
    video            frames to the server
    health           whether rosbridge and web_video_server answer
    battery          how full the robot's battery is
    install          makes a version's folder; the installer runs it from the wheel
    upgrade          puts another version in use and goes back if it fails
    status           how the agent is, for people and programs; `systemd` gets it, too, and the log
    settings         agent.toml and the environment, read once
    problems         everything that can go wrong; `backoff` says what then, `describe_error` names it
"""

__version__ = "0.1.0"

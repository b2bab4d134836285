"""The agent of Robotether: the boot service on a robot that keeps its tunnel to the server open.

systemd starts it as `robotether-agent run`. It must never accept a changed host key, and never lead anybody past its
guard to rosbridge unless the robot's own settings say so.

    cli              the command `robotether-agent`; `doctor` runs all checks, `status` says how the agent is,
                     `users` lets what root starts write as the agent's own user
    settings         agent.toml and the environment, read once; `setting_values` parses, `log` is set up by it
    problems         everything that can go wrong; `backoff` says what then, `describe_error` and `ssh_errors` name it
    fields, files    typed getters for what comes from outside; the agent's own small files

    agent            the main loop; `tasks` keeps its parts together, `notify` tells systemd
    enroller         makes sure that the robot is enrolled: `join` asks, `keys` and `known_hosts` and `enrolment`
                     keep, `identity` finds the MAC and `identity_store` holds on to it, `unenrol` undoes it
    supervisor       keeps one connection going; `connection` is one attempt, `connector` gets the TCP connection
                     (`dialing`), `tunnel` runs OpenSSH on it by `ssh_command`
    session          the protocol on it; `session_messages` are the lines about driving, `requested_features` those
                     about keys and shell, `clock` gives commands their age
    liveness         ends a connection that is dead: `netlink` reports changes of the network
    guard_supervisor keeps a guard running: `guard_process` is one, `guard_handle` one with its listener
    guard, media     the filter before rosbridge, a process of its own; the proxy that paces video
    health           whether rosbridge and web_video_server answer

    upgrade          puts another version in use and goes back if it fails; `versions`, `pending_upgrade` and
                     `systemd` are what that needs
"""

__version__ = "0.1.0"

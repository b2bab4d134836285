"""The guard: sits in front of the robot's rosbridge and stops the robot when commands stop.

A process of its own, forked for the agent, so that neither the agent's other work nor its crash can delay a stop.
docs/reference/protocols.md, "The guard", says what it does. It must never let a drive command through that it has not
checked, never move the robot by itself, and never publish where nobody has driven through it.

    operator -> server -> drive_messages -> drive_controller -> rosbridge
                   `---- everything else, unchanged ----> rosbridge

    process           the parts put together; reads and answers the agent (`agent_messages`), ends stopped
    server            lets operators in, and joins each to a rosbridge connection of its own
    drive_messages    finds what concerns drive topics, reads it field by field and limits it, or refuses it
    drive_controller  decides who may drive: key, lease, stop, session, a living agent; checks and sends commands, and
                      the zeros that are due
    seen_age          how old is what a driver sees, and how fast the robot may be for it
    topics            what it knows of each topic: the command, the deadman, the file that says that the robot moves
    rosbridge         the connections to it: each operator's, and the one on which commands and zeros go
    latch             the stop

In the agent's own process `supervisor` keeps a guard running, and `child_process` is one of them. `fork_server` is
the process that forks them, and the agent's end of it.
"""

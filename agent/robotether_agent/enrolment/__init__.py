"""Who this robot is: its MAC, its key, the join, and what the server answered.

An enrolled robot connects without asking. The pin of the first join is never changed by anything but a person.

    enroller          makes sure that the robot is enrolled, and undoes it; `join` asks the server
    enrolment_store   what an active join gave; `known_hosts` pins the server's host keys
    identity          finds the MAC; `identity_store` holds on to it
    keys              the robot's own key, and the next one
"""

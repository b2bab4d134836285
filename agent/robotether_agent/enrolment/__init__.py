"""Who this robot is: its MAC, its key, the join, and what the server answered.

An enrolled robot connects without asking. The pin of the first join is never changed by anything but a person.

    enroller   makes sure that the robot is enrolled, keeps what an active join gave, and undoes it
    join       asks the server
    identity   finds the MAC, and holds on to it
    keys       the robot's own key, the next one, and the pin of the server's host keys
"""

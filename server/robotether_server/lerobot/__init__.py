"""Makes training data of recordings: a LeRobot dataset, for the command `robotether recording export`.

Needs the extra `lerobot`. It runs on a person's own machine, with files of which a robot wrote a part, so nothing in
them is trusted. `export` is the entry.
"""

"""Every rule that writes: one function an action, with its checks, its change and its audit line.

Used by web and cli, which ask the person and show the outcome. Every function takes the open Transaction
first, so that several actions of one request are done together or not at all, and raises Problems whose detail
is the sentence for that person. The caller has checked the right to do it. Log-ins (logging_in.py) open their
transactions themselves.
"""

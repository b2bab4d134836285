"""robotether fleet ...: commands on many robots at once, over the shells that `robotether ssh-config` lists.

Started by a person on a machine of their own; needs OpenSSH's client, whose configuration it reads, and no database.
Must never send anything to a host whose key it has not checked, and never to one that is no robot.
"""

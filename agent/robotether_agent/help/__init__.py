"""When the robot asks for a person, by a topic or by a rule of its settings.

`rules` says when, and is pure; `caller` reads the topics, and sends each call over the session.
"""

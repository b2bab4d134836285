"""How the file of a recording is laid out: the recorder writes it, and the export for training reads it."""

import struct

MAGIC = b"\x89MCAP0\r\n"
# Opcode and length of a record of MCAP.
RECORD = struct.Struct("<BQ")
# The beginning of each message: CDR, little endian, no options. Alignment counts from its end.
CDR_START = b"\0\1\0\0"
# Topics of our own; a robot's topics below it are not recorded.
NAMESPACE = "/robotether/"
# What follows a camera's name in the topic of its JPEGs, and of all else.
IMAGE_SUFFIX, VIDEO_SUFFIX = "/compressed", "/video"

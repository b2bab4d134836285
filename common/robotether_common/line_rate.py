"""What the robot's line carries (docs/reference/media.md, "The line"), as agent and relay know it."""

PATH = "/robotether/line"
# Its only member: bytes a second, or null.
BYTES_PER_S = "bytes_per_s"

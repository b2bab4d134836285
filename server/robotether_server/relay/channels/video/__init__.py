"""Robots' cameras to viewers: the frames protocol, streams, and web_video_server passed through."""

"""Robots' cameras to viewers: the frames protocol, multipart streams, and web_video_server passed through."""

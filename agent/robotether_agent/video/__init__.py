"""Frames to the server, which use the uplink without delaying control.

What is not wanted is dropped where it is made; nothing waits in between.

    video_proxy          the end of the media forward: passes streams on as fast as the uplink takes them
    pacer                shares the uplink by what `bandwidth_estimator` makes of the connection
    frames_service       frames by credit: a `receiver` each, with `quality` in steps and a few `waiting_frames`
    frame_encoder        H.264 or VP8 for one receiver, by the rules of `encoding`: an `encoder` each, which keeps an
                         `encoder_process` running
    shared_sources       one source for all who ask the same; `sources` opens it, RTSP and devices by `camera_process`,
                         raw images by an `image_process`
"""

"""A simulated robot: what a ROS robot shows on its ports 9090 and 8080, without ROS.

Started as `python -m sim_robot` by images/sim_robot/entrypoint. Nothing here is for a real robot.
"""

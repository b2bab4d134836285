"""The launch file is all of this package; ament_python wants a module."""

"""Counts a drive for its record."""

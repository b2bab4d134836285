"""Experiments on the real stack: `make experiments` runs them and writes a page each into docs/experiments.

Imports go one way: step -> world, programs -> client -> virtual -> fleet -> density, cells -> requests -> experiments.
"""

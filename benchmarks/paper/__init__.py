"""The paper's experiments and more on the real stack: `make experiments` runs them and writes a page each.

Imports go one way: step, networks -> world, programs -> robots -> a folder for each family of experiments -> page ->
experiments.
"""

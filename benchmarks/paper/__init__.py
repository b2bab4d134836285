"""The paper's five experiments, and a comparison, on the real stack: `make experiments` runs them and writes the page.

Imports go one way: step, networks -> world, programs -> robots -> a folder for each family of experiments -> page ->
experiments.
"""

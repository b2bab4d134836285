"""The paper's five experiments, and a comparison, on the real stack: `make experiments` runs them and writes the page.

Imports go one way: step, networks -> world -> robots -> one folder a family of experiments -> page -> experiments.
"""

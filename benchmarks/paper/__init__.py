"""The paper's five experiments, and a comparison, on the real stack: `make experiments` runs them and writes the page.

Imports go one way: step, profiles -> world -> one module an experiment -> page -> runner.
"""

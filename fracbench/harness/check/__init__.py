"""Whether stored numbers still hold: the regression check, its tolerances, and two runs compared cell by cell.

Imports `fracbench.harness.run` and the rooms that it may import.
"""

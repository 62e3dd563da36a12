"""Tables 1 and 2 and Figures 1 to 7 of the paper.

Imports the rooms that `fracbench.studies` may import.
"""

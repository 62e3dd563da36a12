"""Flow in two parts of different orders against single orders: on rendered scenes and on Middlebury.

Imports the rooms that `fracbench.studies` may import.
"""

"""Flows of fluids: errors against the order, beside cross-correlation, and against each setting of the images.

Imports the rooms that `fracbench.studies` may import.
"""

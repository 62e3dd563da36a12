"""Alpha by class of structure: its leave-one-out gain over one order, and its oracle bounds.

Imports the rooms that `fracbench.studies` may import.
"""

"""The best order for each structure, on scenes of one structure and on classes of pixels.

Imports the rooms that `fracbench.studies` may import.
"""

"""Which order is best for which structure, by scenes of one structure and classes of pixels.

Imports what `fracbench.studies` may.
"""

"""The speed of the methods beside that of peers.

Imports what `fracbench.studies` may.
"""

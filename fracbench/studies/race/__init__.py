"""The speed of the methods beside that of peers.

Imports the rooms that `fracbench.studies` may import.
"""

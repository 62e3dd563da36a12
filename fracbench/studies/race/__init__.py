"""The speed of the methods beside that of peers.

A race is a timing of this machine at this hour: it is measured anew each time, and no point of the store.
Imports the rooms that `fracbench.studies` may import.
"""

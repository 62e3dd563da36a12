"""The user's input: override grammar, configuration groups, experiments, and the paths of the project's files.

Imports `fracbench.data`, `fracbench.methods` and the rooms that these may import.
"""

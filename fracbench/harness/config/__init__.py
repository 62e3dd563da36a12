"""The user's input: override grammar, configuration groups, experiments, and the paths of the project's files.

Imports `fracbench.data`, `fracbench.methods` and what these may import.
"""

"""The residuals of the data term: brightness, gradients, textures, and their weights by visibility.

Imports `fracbench.errors` and the rest of `fracbench.model`.
"""

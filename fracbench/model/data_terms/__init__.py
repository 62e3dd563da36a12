"""The residuals of the data term: brightness, gradients, textures, and what is seen in both frames.

Imports `fracbench.errors` and the rest of `fracbench.model`.
"""

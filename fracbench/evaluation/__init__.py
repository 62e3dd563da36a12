"""Errors of a flow against the true flow, over all pixels, by class of pixels, and with confidence intervals;
derivatives of a flow.

Imports `fracbench.errors` and `fracbench.model.structure`.
"""

"""Alpha by class of structure

Imports  what it gains over one order, and the oracle bound.:what `fracbench.studies` may.
"""

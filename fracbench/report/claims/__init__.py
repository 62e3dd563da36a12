"""The paper's testable sentences, the rules that judge them, and the answer in short.

Imports `fracbench.studies` and what it may import.
"""

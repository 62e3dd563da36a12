"""The HTML page: its sections, the elements they are made of, and the template.

Imports `fracbench.report.claims`, `fracbench.studies` and what these may import.
"""

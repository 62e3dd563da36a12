"""Sequences with known flow: Middlebury, rendered scenes, regions of them, and their files."""

"""The command line: its parser, and one module for each kind of command.

May import every other room.
"""

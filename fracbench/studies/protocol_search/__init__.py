"""The search for the run behind the printed Table 2 (docs/protocol.md).

It may import what the room `studies` may; `search` needs Optuna.
"""

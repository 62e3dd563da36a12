"""Completion of the command line in a shell, by argcomplete where it is installed."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from contextlib import suppress
from typing import Any


def complete(parser: argparse.ArgumentParser) -> None:
    """Print the words that may follow and leave; return where argcomplete is missing."""
    with suppress(ImportError):
        import argcomplete

        (commands,) = (action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
        for sub in commands.choices.values():
            for action in sub._actions:
                if action.dest == "overrides":
                    action.completer = _overrides
                elif action.dest == "name":
                    action.completer = _experiments
        argcomplete.autocomplete(parser)


def _overrides(prefix: str, **_more: Any) -> Iterable[str]:
    """Return keys, and behind ``=`` the names of the key's group."""
    from fracbench.harness.config.compose import GROUPS, group_options, known_keys

    key, equals, _ = prefix.partition("=")
    if not equals:
        return [f"{known}=" for known in known_keys()]
    return [f"{key}={name}" for name in group_options(key)] if key in GROUPS else []


def _experiments(**_more: Any) -> Iterable[str]:
    from fracbench.harness.config.experiment import list_experiments

    return list_experiments()

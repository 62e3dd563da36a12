"""Reading the command line: errors are one line and name the nearest valid word; shells complete the others."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Any, NoReturn

from fracbench.errors import InputError, nearest


class Parser(argparse.ArgumentParser):
    """An argument parser with errors of one line that name the nearest valid word, and no abbreviated options."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, **settings)

    def error(self, message: str) -> NoReturn:
        """Raise `InputError`, where argparse would print and leave."""
        subcommands = [action for action in self._actions if isinstance(action, argparse._SubParsersAction)]
        choices = [name for action in subcommands for name in action.choices]
        given = message.partition("invalid choice: '")[2].partition("'")[0]
        if given and choices:
            guess = nearest(given, choices)
            hint = f": did you mean {guess!r}?" if guess else ""
            message = f"unknown command {given!r}{hint} (allowed: {', '.join(choices)})"
        raise InputError(" ".join(message.split()))

    def parse_words(self, argv: Sequence[str]) -> argparse.Namespace:
        """Return the arguments; overrides may stand anywhere, other unknown words are refused."""
        arguments, rest = self.parse_known_args(argv)
        # argparse takes overrides up to the first option only.
        for word in rest:
            if word.startswith("-") or "=" not in word or not hasattr(arguments, "overrides"):
                options = [option for action in arguments.parser._actions for option in action.option_strings]
                guess = nearest(word, options)
                hint = f": did you mean {guess}?" if guess else ""
                raise InputError(f"unexpected argument {word!r}{hint}")
            arguments.overrides.append(word)
        return arguments


class Moved(argparse.Action):
    """An option that is gone; its `const` names the script of a checkout in its place, by the option's value."""

    def __call__(self, parser: argparse.ArgumentParser, _: Any, value: Any, option: str | None = None) -> NoReturn:
        """Raise `InputError` that names the script."""
        words = f"{parser.prog.split()[-1]}: {option} {value or ''}".rstrip()
        raise InputError(f"{words} has moved: python {self.const[value or '']}, in a checkout")


def complete(parser: argparse.ArgumentParser) -> None:
    """Print the words that may follow, as argcomplete does, and leave; return where it is missing."""
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

"""The parser of the command line: it refuses in one sentence."""

import argparse
import re
import sys
import typing
from collections.abc import Callable, Sequence

from perilife_data import did_you_mean


class OneSentenceParser(argparse.ArgumentParser):
    """A parser that refuses in one sentence, without repeating the usage.

    expand: turns the arguments into those that are parsed (pipeline.scene.command.scene_file).
    """

    expand: Callable[[list[str]], list[str]] | None = None

    def __init__(self, *arguments: object, **options: object) -> None:
        super().__init__(*arguments, **options)
        # no option begins with a digit, so that -2mm is a (refused) length and no option
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def parse_known_args(
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parse, what a scene file says in front of what was typed."""
        arguments = list(sys.argv[1:] if args is None else args)
        if self.expand is not None:
            arguments = self.expand(arguments)
        return super().parse_known_args(arguments, namespace)

    def parse_args(
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> argparse.Namespace:
        """Parse; whatever else is wrong, an option that is not known is refused first."""
        arguments = list(sys.argv[1:] if args is None else args)
        try:
            return super().parse_args(arguments, namespace)
        except (ValueError, OSError):
            unknown = self._unknown(arguments)
            if not unknown:
                raise
        self.error(f"unrecognized arguments: {' '.join(unknown)}")

    def _unknown(self, arguments: Sequence[str]) -> list[str]:
        """The words that look like options and are none of this parser or of its command."""
        commands = self._commands()
        found = []
        for n, word in enumerate(arguments):
            if word in commands:
                return found + commands[word]._unknown(arguments[n + 1 :])
            if word == "--":  # what follows are no options
                break
            option = re.match(r"--?[a-zA-Z][^=\s]*(?=$|=)", word)
            if option and option[0] not in self._option_string_actions:
                found.append(word)
        return found

    def error(self, message: str) -> typing.NoReturn:
        """Refuse, with the nearest command or option where one was not understood."""
        number = re.fullmatch(r"argument (.+): invalid (int|float) value: (.*)", message)
        if number:
            kind = {"int": "a whole number", "float": "a number without unit or per cent sign"}
            message = f"{number[1]} is {number[3]}; it must be {kind[number[2]]}"
        unknown = re.search(r"(?:unrecognized arguments: |invalid choice: ')([^\s']+)", message)
        near, names = "", self._names()
        if unknown:
            other = unknown.group(1) in names  # of a command
            near = " (of another command)" if other else did_you_mean(unknown.group(1), names)
        raise ValueError(f"{message}{near}; see `{self.prog} --help`")

    def _names(self) -> set[str]:
        """Every option and command of this parser and of those below it."""
        commands = self._commands()
        return set(self._option_string_actions).union(
            commands, *(parser._names() for parser in commands.values())
        )

    def _commands(self) -> dict[str, "OneSentenceParser"]:
        """The parsers of the commands by their names; none below a command."""
        actions = [a for a in self._actions if isinstance(a, argparse._SubParsersAction)]
        return {name: parser for a in actions for name, parser in a.choices.items()}


def take_folder(parser: OneSentenceParser) -> None:
    """Let a command of a run folder take it as its first word, without --out."""
    parser.epilog = f"{parser.prog} DIR ... is {parser.prog} --out DIR ..."

    def expand(arguments: list[str]) -> list[str]:
        named = arguments[:1] and not arguments[0].startswith("-")
        return ["--out", *arguments] if named else arguments

    parser.expand = expand

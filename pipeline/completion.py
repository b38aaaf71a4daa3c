"""The command `perilife completion`: what a shell needs to complete commands and options."""

import argparse

SHELLS = ("bash", "zsh", "tcsh")


def add_completion_options(parser: argparse.ArgumentParser) -> None:
    """Options of `perilife completion`."""
    parser.add_argument("shell", choices=SHELLS, help="the shell that is to complete")


def print_completion(parser: argparse.ArgumentParser, shell: str) -> None:
    """Print the script; `parser` is that of the whole command.

    Raises
    ------
    ValueError
        shtab, which writes the script, is not installed.
    """
    try:
        import shtab
    except ImportError as error:
        raise ValueError(
            "completion needs shtab, which is not installed; pip install 'perilife[completion]'"
        ) from error
    print(shtab.complete(parser, shell))

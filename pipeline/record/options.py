"""Options of the commands that work in a run folder; nothing slow is imported for them."""

import argparse


def add_folder_options(parser: argparse.ArgumentParser, resume: bool = False) -> None:
    """Where a command writes, and whether it says what it does; resume: and whether it goes on."""
    parser.add_argument("--out", required=True, metavar="DIR", help="the run folder")
    parser.add_argument("--quiet", action="store_true", help="no progress")
    if resume:
        parser.add_argument("--resume", action="store_true", help="go on with the same scene")


def add_machine_options(parser: argparse.ArgumentParser, march: bool = False) -> None:
    """How many processes share the pulls of a run; march: and each corrosion march."""
    parser.add_argument("--np", type=int, default=1, metavar="NP", help="MPI ranks per pull (1)")
    parser.add_argument(
        "--pulls", type=int, metavar="N", help="pulls at a time (as many as cores allow)"
    )
    if march:
        add_ranks_options(parser)
    else:
        _add_oversubscribe(parser)


def add_ranks_options(parser: argparse.ArgumentParser) -> None:
    """How many processes share each march."""
    parser.add_argument(
        "--ranks", type=int, default=1, metavar="N", help="MPI ranks of each corrosion march (1)"
    )
    _add_oversubscribe(parser)


def _add_oversubscribe(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--oversubscribe", action="store_true", help="allow more ranks and pulls than cores"
    )

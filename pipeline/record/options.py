"""Options of the commands that work in a run folder; nothing slow is imported for them."""

import argparse


def add_folder_options(parser: argparse.ArgumentParser, resume: bool = False) -> None:
    """Where a command writes, and whether it says what it does; resume: and whether it goes on."""
    parser.add_argument("--out", required=True, metavar="DIR", help="the run folder")
    parser.add_argument("--quiet", action="store_true", help="no progress")
    if resume:
        parser.add_argument("--resume", action="store_true", help="go on with the same scene")


def add_machine_options(parser: argparse.ArgumentParser) -> None:
    """How many processes share the pulls of a run."""
    parser.add_argument("--np", type=int, default=1, metavar="NP", help="MPI ranks per pull (1)")
    parser.add_argument(
        "--pulls", type=int, metavar="N", help="pulls at a time (as many as cores allow)"
    )
    parser.add_argument(
        "--oversubscribe", action="store_true", help="allow more ranks and pulls than cores"
    )

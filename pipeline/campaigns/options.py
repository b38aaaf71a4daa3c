"""Options of the commands of this room; nothing slow is imported for them."""

import argparse

LENGTHS = ("diameter", "length", "pitch", "slot_width", "slot_depth")
"""Lengths of the screw that a design may vary within a range."""

COATING = ("coating_factor", "coating_lifetime")
"""Numbers of --coating that a design may vary within a range."""


def add_sample_options(parser: argparse.ArgumentParser) -> None:
    """Options of `perilife run` for bands from samples."""
    parser.add_argument(
        "--samples",
        type=int,
        metavar="N",
        help="bands from N samples of the constants (needs a set that calibrate wrote)",
    )
    parser.add_argument(
        "--strength-tolerance",
        type=float,
        metavar="X",
        help="with --samples: of the strength curve behind the bands, over the intact one's (0.01)",
    )
    parser.add_argument(
        "--surrogate",
        type=int,
        metavar="N",
        help="with --samples, where the liquid counts: Kriging through at most N marches and their "
        "tests (needs perilife[surrogate])",
    )


def add_until_options(parser: argparse.ArgumentParser) -> None:
    """Options of `perilife run` that ask when the part becomes too weak."""
    group = parser.add_argument_group("when is it too weak? (within the immersion times)")
    group.add_argument(
        "--until-left", type=float, metavar="X", help="with less than this share of its strength"
    )
    group.add_argument(
        "--until-force", metavar="F", help="with a smaller peak: 300N; a torque or moment: 60Nmm"
    )


def add_design_options(parser: argparse.ArgumentParser) -> None:
    """Options of `perilife design` beside those of the scene."""
    group = parser.add_argument_group("design")
    group.add_argument(
        "--strength-left", type=float, metavar="X", help="share of the intact strength"
    )
    group.add_argument("--force", metavar="F", help="or a force, as 300N")
    group.add_argument("--at", required=True, metavar="T", help="when it must be left, as 12w")
    group.add_argument(
        "--probability", type=float, metavar="P", help="with the samples of a fitted set"
    )
    names = ", ".join(n.replace("_", "-") for n in (*LENGTHS, *COATING))
    group.add_argument(
        "--vary",
        required=True,
        action="append",
        metavar="NAME=LOW:HIGH",
        help=f"one of {names}; or NAME=A,B of any option, as alloy=A,B; twice: the front of both",
    )
    group.add_argument(
        "--strength-tolerance",
        type=float,
        default=0.01,
        metavar="X",
        help="of the strength curve by which a coating is searched, of the intact strength (0.01)",
    )


def add_campaign_options(parser: argparse.ArgumentParser) -> None:
    """Options of `perilife campaign`."""
    parser.add_argument("campaign", metavar="CAMPAIGN.toml", help="alloys, times, options, samples")
    parser.add_argument("--engine", default="local", metavar="E", help="local, dask or mpi (local)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="of Dask, as tcp://host:8786")
    parser.add_argument("--workers", type=int, metavar="N", help="tasks at a time (the cores)")

"""The command `perilife alloy new`: a file to fill in for an alloy of one's own."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from pipeline.scene.scene import SceneError


def add_alloy_options(parser: argparse.ArgumentParser) -> None:
    """Options of `perilife alloy`."""
    parser.add_argument("what", metavar="WHAT", help="new: write a file for an alloy, to fill in")
    parser.add_argument("name", metavar="NAME", help="name of the alloy")
    parser.add_argument("--like", metavar="A", help="begin from a shipped alloy's numbers")
    parser.add_argument("--out", metavar="FILE", help="file to write (NAME.toml, lower case)")


def run_alloy(options: argparse.Namespace, say: Callable[[str], None]) -> None:
    """Write the file; ValueError or OSError with one sentence where that cannot be."""
    from perilife_data.own_files import FILL_IN
    from perilife_data.template import alloy_like, alloy_template

    if options.what != "new":
        raise SceneError(f"alloy '{options.what}' is not known; it must be: alloy new NAME")
    name = options.name
    text = alloy_template(name) if options.like is None else alloy_like(name, options.like)
    path = Path(options.out or f"{name.lower()}.toml")
    if path.suffix != ".toml":
        raise SceneError(f"--out is '{path}'; the file of an alloy ends in .toml")
    if path.exists():
        raise FileExistsError(f"'{path}' is there already; choose another name or --out")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"--out is '{path}', whose folder does not exist")
    path.write_text(text, encoding="utf-8")
    say(str(path))
    if options.like is not None:
        say(f"Change what differs from {options.like}, with sources.")
    else:
        say(
            f'To fill in, each marked "{FILL_IN}": title; composition; young_modulus, '
            "poisson_ratio, yield_stress, ultimate_tensile_strength, uniform_strain, q1, each with "
            "kind and source (a key of references.bib in its folder; the file begins with one)."
        )
    say("With [corrosion] it can be corroded, too; without, it can be pulled (--immersion 0w).")
    if options.like is None:
        say(
            "To fit [corrosion] to your own volume losses, uncomment it (the file says how); then: "
            f"perilife calibrate --alloy {path} --volume-loss {name}=FILE.csv --out fits/{name}"
        )
    say(f"Then: perilife run --alloy {path} --immersion 0w --out runs/{name}")

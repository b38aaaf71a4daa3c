"""A life cycle from Python: the options of `perilife run` as keywords."""

from __future__ import annotations

import argparse
import copy
import inspect
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.run import add_run_options, carry_out, resolved, scene_of
from pipeline.scene.command.arguments import arguments_of, options_of, unknown_name
from pipeline.scene.command.parser import OneSentenceParser

if TYPE_CHECKING:
    from pipeline.api.results import Results
    from pipeline.scene.scene import Scene

RUNS = "runs"
"""Folder, in the current one, of the runs that were not told where to write."""


class LifeCycle:
    """A solid of one or more alloys, corroded and pulled: `LifeCycle("Mg-5Gd", "8w").run()`.

    Parameters
    ----------
    alloy : str or list of str
        Names (`perilife alloys`) or TOML files of alloys.
    immersion : str, number or list of these
        Rising times: "8w", ["0w", "8w"]; numbers are seconds.
    **options
        Every option of `perilife run` by its name, with underscores: `hold="all"`,
        `mesh_size="0.2mm"`, `resolution="standard"`, `out="runs/mine"`.  Values are text as typed
        on the command line, or numbers in SI (`mesh_size=0.2e-3`).

    Without `out` the run is kept in `runs/`, in a folder named by alloys, last time and a hash of
    the scene; asking for the same scene again reads what is there.

    Raises TypeError for a keyword that is no option, with the nearest one; ValueError or OSError
    with one sentence for values that cannot be computed.
    """

    def __init__(
        self,
        alloy: str | Iterable[str] | None = None,
        immersion: object = None,
        **options: object,
    ):
        self._options = read_keywords({"alloy": alloy, "immersion": immersion, **options})
        self.scene: Scene = scene_of(self._options)

    def __repr__(self) -> str:
        alloys = ", ".join(alloy.name for alloy in self.scene.alloys)
        times = ", ".join(time.label for time in self.scene.immersion)
        return f"<LifeCycle of {alloys} after {times}, {self.scene.resolution}>"

    def run(self) -> Results:
        """Do every stage that is not done yet and return the results.

        Says what it does where stderr is a terminal.  Raises ValueError, OSError or MemoryError
        with one sentence for what cannot be computed here, RuntimeError for a test that failed.
        """
        from pipeline.api.results import Results
        from pipeline.record.machine import prepare_libraries
        from pipeline.record.progress import progress_for

        prepare_libraries()
        options = copy.copy(self._options)
        scene, solid = resolved(options)
        if options.out is None:
            options.out, options.resume = str(_folder(scene)), True
        quiet = options.quiet or not sys.stderr.isatty()
        with progress_for(sys.stderr, quiet, options.log) as progress:
            folder, _ = carry_out(options, scene, solid, progress)
        return Results(folder.path)


def _parser() -> OneSentenceParser:
    parser = OneSentenceParser(prog="perilife run", add_help=False, allow_abbrev=False)
    add_run_options(parser)
    return parser


def _signature() -> inspect.Signature:
    """Every keyword by its name, for `help` and for completion in notebooks."""
    kinds = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return inspect.Signature(
        [
            inspect.Parameter(name, kinds[name not in ("alloy", "immersion")], default=a.default)
            for name, a in options_of(_parser()).items()
        ]
    )


LifeCycle.__signature__ = _signature()


def read_keywords(values: Mapping[str, object]) -> argparse.Namespace:
    """The options of `perilife run` that the keywords give, `out` as None where it is left out."""
    parser = _parser()
    known = options_of(parser)
    unknown = unknown_name(known, values)
    if unknown:
        raise TypeError(
            f"LifeCycle() has no keyword {unknown}; its keywords are the options of "
            "`perilife run` with underscores"
        )
    known["out"].required = False
    return parser.parse_args(arguments_of(known, values))


def _folder(scene: Scene) -> Path:
    """Where a scene is kept that was not told where."""
    alloys = "_".join(alloy.name for alloy in scene.alloys)
    return Path(RUNS, f"{alloys}-{scene.immersion[-1].label}-{scene.hash()[:8]}")

"""What a run has found, by name: numbers, curves, fields, drawings, sources."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.record.run_folder import RunFolder, RunFolderError
from pipeline.record.summary import SummaryRow, read_summary
from pipeline.scene.loads import LOADS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pipeline.api.table import Table
    from pipeline.export.state import CorrodedState
    from pipeline.record.run_results import RunResults
    from pipeline.record.until import UntilRow
    from pipeline.scene.scene import Scene


class Results:
    """The results of a run folder, of all its alloys and ways of holding or of those chosen.

    Parameters
    ----------
    folder : path
        A run folder with a finished run.
    alloy, hold : str, optional
        Only these.

    Numbers of one test (`strength_left`, `volume_loss`, `peak_force`) are those after the last
    immersion time; `table()` has all times.  Where the run has several alloys or ways of holding,
    `only` chooses.

    Raises FileNotFoundError or ValueError with one sentence for a folder without a finished run, an
    alloy or a way of holding that is not there.
    """

    def __init__(self, folder: Path | str, alloy: str | None = None, hold: str | None = None):
        from pipeline.planning.opening import read_run as open_folder

        self._run_folder: RunFolder
        self.scene: Scene
        self._run_folder, self.scene = open_folder(folder)
        self.folder = self._run_folder.path
        self.alloy = None if alloy is None else self.scene.alloy(alloy).name
        self.hold = None if hold is None else self.scene.hold(hold).name
        summary = self._run_folder.summary_file
        if not summary.is_file():
            raise RunFolderError(
                f"run folder '{folder}' holds no {summary.name}, so its run is not finished; "
                "`perilife run --resume` goes on with it"
            )
        rows = read_summary(summary)
        self.rows: tuple[SummaryRow, ...] = tuple(
            row for row in rows if self.alloy in (None, row.alloy) and self.hold in (None, row.hold)
        )

    @property
    def alloys(self) -> tuple[str, ...]:
        """Names of the alloys."""
        return tuple(dict.fromkeys(row.alloy for row in self.rows))

    @property
    def holds(self) -> tuple[str, ...]:
        """Names of the ways of holding."""
        return tuple(dict.fromkeys(row.hold for row in self.rows))

    @property
    def times(self) -> tuple[str, ...]:
        """Immersion times as typed; `curve` and `damage` know 0w, too."""
        return tuple(time.label for time in self.scene.immersion)

    @property
    def report(self) -> Path:
        """The report, a page that stands alone."""
        return self._run_folder.report_file

    def only(self, alloy: str | None = None, hold: str | None = None) -> Results:
        """The results of one alloy, of one way of holding, or of both."""
        return Results(self.folder, alloy or self.alloy, hold or self.hold)

    @property
    def strength_left(self) -> float:
        """Peak over that of the intact solid after the last immersion time, 0..1."""
        return self._last().strength_ratio

    @property
    def volume_loss(self) -> float:
        """Lost mass over the mass that can be lost after the last immersion time, 0..1."""
        return self._last().volume_loss

    @property
    def peak_force(self) -> float:
        """Largest force after the last immersion time, N."""
        return self._peak("force")

    @property
    def peak_torque(self) -> float:
        """Largest torque after the last immersion time, N m."""
        return self._peak("torque")

    @property
    def peak_moment(self) -> float:
        """Largest moment after the last immersion time, N m."""
        return self._peak("moment")

    def table(self) -> Table:
        """The columns of summary.csv by name; shown as a table, and `pandas.DataFrame` takes it."""
        from pipeline.api.table import Table

        return Table(self.rows)

    def state(self, time: str) -> CorrodedState:
        """Mesh, damage, grips and material after an immersion time (pipeline.export.state)."""
        from pipeline.export.state import read_state

        return read_state(self.folder, time, self._one("alloy"), self._one("hold"))

    def curve(self, time: str) -> dict[str, NDArray[np.float64]]:
        """Columns of tensile.csv after an immersion time, by name with unit.

        `elongation` (nominal), `displacement_m`, `force_N`, each (n,), and what the solution took.
        """
        return self.state(time).curve

    def damage(self, time: str) -> NDArray[np.float64]:
        """Corrosion damage f0 of each cell after an immersion time, (nc,)."""
        return self.state(time).corrosion_damage

    def export(
        self, to: str, time: str, out: Path | str | None = None, classes: int = 20
    ) -> list[Path]:
        """Write the solid after an immersion time for another program, as `perilife export` does.

        to: inp, exodus, vtu, xdmf or npz; out: the file, in the run folder where left out; classes:
        of damage, in an .inp.  Returns the files.
        """
        import argparse

        from pipeline.export.command import run_export

        files: list[Path] = []
        options = argparse.Namespace(
            run=self.folder,
            to=to,
            time=time,
            alloy=self._one("alloy"),
            hold=self._one("hold"),
            out=None if out is None else str(out),
            classes=classes,
        )
        run_export(options, lambda written: files.append(Path(written)))
        return files

    def plot(self) -> Figure:
        """Strength left against time, and the curves of the tests: a matplotlib Figure.

        A notebook shows it; `.savefig("FILE.png")` writes it.
        """
        from pipeline.api.plot import plot_results

        return plot_results(self._read, self.alloys, self.holds)

    @property
    def sources(self) -> dict[str, str]:
        """Reference of every source whose numbers the run used, by its key in references.bib."""
        from pipeline.report.provenance import parameter_rows, references

        rows = [row for row in parameter_rows(self.scene) if row.alloy in ("", *self.alloys)]
        return references(rows, self.scene)

    @property
    def until(self) -> list[UntilRow]:
        """When it becomes too weak, where that was asked for (`until_left`, `until_force`)."""
        from pipeline.record.until import UNTIL_FILE, read_until

        rows = read_until(self.folder / UNTIL_FILE)
        return [row for row in rows if row.alloy in self.alloys and row.hold in self.holds]

    def headlines(self) -> list[str]:
        """The answer in a sentence for each alloy and way of holding, and when it is too weak."""
        from pipeline.report.wording import headline

        load = LOADS[self.scene.tensile.load]
        said = [
            headline(alloy, load)
            for hold in self.holds
            for alloy in self._read.held[hold]
            if alloy.name in self.alloys
        ]
        return said + [row.in_words() for row in self.until]

    @cached_property
    def _read(self) -> RunResults:
        from pipeline.record.run_results import read_run

        return read_run(self.folder)

    def __repr__(self) -> str:
        return "\n".join([*self.headlines(), str(self.table()), f"report: {self.report}"])

    def _repr_html_(self) -> str:
        from html import escape

        said = "".join(f"<p>{escape(line)}</p>" for line in self.headlines())
        where = f"<p>report: <code>{escape(str(self.report))}</code></p>"
        return said + self.table()._repr_html_() + where

    def _last(self) -> SummaryRow:
        alloy, hold = self._one("alloy"), self._one("hold")
        return [row for row in self.rows if (row.alloy, row.hold) == (alloy, hold)][-1]

    def _peak(self, reaction: str) -> float:
        load = self.scene.tensile.load
        if LOADS[load].reaction != reaction:
            known = LOADS[load].reaction
            raise AttributeError(f"the load is {load}, so there is no {reaction}; see peak_{known}")
        return self._last().peak_reaction

    def _one(self, what: str) -> str:
        """The one alloy or way of holding; refused where there are several."""
        found = getattr(self, f"{what}s")
        if len(found) > 1:
            said = {"alloy": "alloys", "hold": "ways of holding"}[what]
            raise ValueError(
                f"these results are of several {said} ({', '.join(found)}); choose one, as "
                f"only({what}='{found[0]}')"
            )
        return found[0]

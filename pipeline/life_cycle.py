"""The life cycle: geometry, corrosion, damage map, tensile tests, table and report, with resume.

Each method of `StagedRun` does one stage unless its record says that it is complete.  Files and
folders are those of `pipeline.record.run_folder`.
"""

import logging
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

from pipeline.record import interruption, machine
from pipeline.record.progress import Progress
from pipeline.record.run_folder import RunFolder, RunFolderError, StageRecord, utc_now
from pipeline.record.stage_hashes import (
    corrosion_hash,
    geometry_hash,
    map_hash,
    pull_hash,
    report_hash,
)
from pipeline.record.summary import SummaryRow, write_summary
from pipeline.scene.loads import LOADS
from pipeline.scene.mapping import fallen_back
from pipeline.scene.scene import HoldScene, Scene
from pipeline.scene.units import ImmersionTime
from pipeline.stages.pulls import Crew, PullQueue, run_jobs
from pipeline.stages.strength import TensileJob, read_result, run_jobs_here, written_files

logger = logging.getLogger(__name__)

Test = tuple[str, ImmersionTime, HoldScene]
"""What is pulled: alloy, immersion time, way of holding."""

Outcome = tuple[list[Path], dict[str, object]]
"""What a stage leaves: the files that must exist, and numbers for its record."""


def run_life_cycle(
    scene: Scene,
    out: RunFolder | Path | str,
    *,
    resume: bool = False,
    ranks: int = 1,
    workers: int | None = None,
    progress: Progress | None = None,
    solid: object = None,
    march_ranks: int = 1,
) -> list[SummaryRow]:
    """Check the scene, open (or with `resume` reopen) the run folder `out` and do every stage.

    solid: that of the scene, where it has been built already; march_ranks: MPI ranks of each march.
    Returns the rows of summary.csv.  Raises ValueError, OSError or MemoryError with one sentence
    for what cannot be computed, TensileStageError for a tensile test without a result.
    """
    from pipeline.planning.opening import open_run

    path = out.path if isinstance(out, RunFolder) else out
    stages = ("geometry", "corrode", "map", "pull")
    with open_run(
        scene,
        path,
        resume,
        solid=solid,
        stages=stages,
        ranks=ranks,
        workers=workers,
        march_ranks=march_ranks,
    ) as (folder, solid):
        cycle = StagedRun(
            scene, folder, ranks=ranks, workers=workers, progress=progress, solid=solid,
            march_ranks=march_ranks,
        )  # fmt: skip
        return cycle.run()


class StagedRun:
    """One run, stage by stage: scene, folder, MPI ranks per pull, pulls at a time.

    workers: None takes as many as the cores allow.  solid: the solid of the scene where it has
    been built already.  march_ranks: MPI ranks of each march, 1 for this very process.  pull_here:
    in this very process, one after another, which then ends with a pull that crashes.  crew:
    children for the pulls, to be kept after the last one.
    """

    def __init__(
        self,
        scene: Scene,
        folder: RunFolder | Path | str,
        *,
        ranks: int = 1,
        workers: int | None = None,
        progress: Progress | None = None,
        solid: object = None,
        march_ranks: int = 1,
        pull_here: bool = False,
        crew: Crew | None = None,
    ):
        self.march_ranks, self.pull_here, self.crew = march_ranks, pull_here, crew
        self.scene = scene
        self.folder = folder if isinstance(folder, RunFolder) else RunFolder(folder)
        self.ranks = ranks
        self.workers = workers or max(1, machine.processor_cores() // ranks)
        self.progress = progress or Progress()
        self._solid = solid
        self._keys: dict[str, Test] = {}  # of what is pulled
        self._by_nodes: set[str] = set()  # alloys of which that was said
        self._foreseen: tuple[dict[str, float], int] | None = None

    def run(self) -> list[SummaryRow]:
        """Every stage for every alloy, immersion time and way of holding.

        Returns the rows of summary.csv.
        """
        times = self.scene.with_intact()
        if times != self.scene.immersion:
            self.progress.note(
                "time zero was not asked for; the intact solid is pulled, too, to compare with"
            )
        names = [alloy.name for alloy in self.scene.alloys]
        tests = [(n, moment, h) for h in self.scene.holds for n in names for moment in times]
        with self._children(tests), self._pulling(tests) as pull:
            self.geometry()
            pull(self._known_intact(tests), mapped=False)
            for name in names:
                self.corrode(name)
                of_alloy = [test for test in tests if test[0] == name]
                for test in of_alloy:
                    self.map(*test)
                pull(of_alloy)
        rows = self.summarise()
        self.report()
        return rows

    @contextmanager
    def _children(self, tests: list[Test]) -> Iterator[None]:
        """Children for the pulls, one of which compiles what they need while the rest is done."""
        missing = [t for t in tests if self.folder.read_record(self._place(t), "pull") is None]
        if not missing or self.pull_here or self.ranks > 1:
            yield
            return
        given = self.crew
        workers = min(self.workers, len(missing))
        with nullcontext(given) if given else Crew(workers, self.folder.descriptors) as self.crew:
            self.crew.prepare(test[2].tensile.element for test in missing)
            try:
                yield
            finally:
                self.crew = given

    @contextmanager
    def _pulling(self, tests: list[Test]) -> Iterator[Callable[..., None]]:
        """What takes tests of a run that can be pulled, and pulls them beside the rest of it.

        Where tests or marches have ranks, tests wait for the end of the block.
        """
        self._warn(tests)
        if self.pull_here or self.ranks > 1 or self.march_ranks > 1:
            waiting: list[Test] = []
            yield lambda some, mapped=True: waiting.extend(some if mapped else [])
            self._pull(waiting)
            return
        queue, taken = PullQueue(**self._how_to_pull()), set()

        def take(some: list[Test], mapped: bool = True) -> None:
            jobs = self._jobs([test for test in some if test not in taken], mapped)
            taken.update(some)
            seconds, queue.at_once = self._expected()
            queue.add(jobs, {key: seconds[self._keys[key][2].name] for key in jobs})

        with queue.meanwhile():
            yield take

    def _known_intact(self, tests: list[Test]) -> list[Test]:
        """The tests of the intact solid, with no damage written where it is not mapped yet.

        At time zero nothing has corroded: they need not wait for a march.
        """
        from pipeline.stages.mapping import map_intact

        found = [test for test in tests if test[1].seconds == 0]
        for test in found:
            inputs, place = map_hash(self.scene, *test), self._place(test)
            if not self.folder.complete(place, "map", inputs):
                self._say_damage("map", place, inputs)
                self.folder.forget(place, "map")
                mesh = self.folder.geometry / self.scene.mesh_folder(test[2])
                map_intact(*test[1:], mesh, place)
        return found

    def _expected(self) -> tuple[dict[str, float], int]:
        """Seconds that a test takes by way of holding, and tests that a march leaves room for."""
        from pipeline.planning.foreseen import pull_seconds, room_beside_march
        from pipeline.stages.geometry import read_surface

        if self._foreseen is None:
            solid = self._solid or read_surface(self.folder.geometry)
            seconds = {h.name: pull_seconds(self.scene, solid, h) for h in self.scene.holds}
            self._foreseen = seconds, room_beside_march(self.scene, solid, self.workers)
        return self._foreseen

    def geometry(self) -> StageRecord:
        """Solid and tetrahedral meshes."""
        from pipeline.stages.geometry import write_geometry

        folder = self.folder.geometry
        return self._do(
            "geometry",
            "geometry",
            folder,
            geometry_hash(self.scene),
            lambda: write_geometry(self.scene, folder, self._solid),
        )

    def corrode(self, alloy: str) -> StageRecord:
        """Corrosion of one alloy, one march through all immersion times."""
        from pipeline.stages.corrosion import corrode_in_folder
        from pipeline.stages.march_on_ranks import corrode_on_ranks

        self._needs("geometry", self.folder.geometry, geometry_hash(self.scene))
        key, folder = f"corrode {alloy}", self.folder.corrosion(alloy)
        inputs, place = corrosion_hash(self.scene, alloy), self.folder.geometry

        def advanced(fraction: float, text: str = "") -> None:
            self.progress.advanced(key, fraction, text)

        def work() -> Outcome:
            if self.march_ranks == 1:
                return corrode_in_folder(self.scene, alloy, place, folder, advanced)
            return corrode_on_ranks(
                self.scene, alloy, place, folder, self.march_ranks, advanced,
                self.folder.descriptors,
            )  # fmt: skip

        return self._do(
            "corrode", key, folder, inputs, work,
            lambda numbers: f"{100 * numbers['volume_loss'][-1]:.1f} % of the metal lost",
        )  # fmt: skip

    def map(self, alloy: str, moment: ImmersionTime, hold: HoldScene) -> StageRecord:
        """Corrosion damage of one alloy after one immersion time on the mesh of a holding."""
        from pipeline.stages.mapping import map_in_folder

        self._needs("geometry", self.folder.geometry, geometry_hash(self.scene))
        corrosion = self.folder.corrosion(alloy)
        self._needs("corrode", corrosion, corrosion_hash(self.scene, alloy))
        folder = self.folder.test(alloy, moment.label, hold.name)
        mesh = self.folder.geometry / self.scene.mesh_folder(hold)
        record = self._do(
            "map",
            f"map {alloy} {moment.label} {hold.name}",
            folder,
            map_hash(self.scene, alloy, moment, hold),
            lambda: map_in_folder(self.scene, alloy, moment, hold, mesh, corrosion, folder),
        )
        because = fallen_back(self.scene, hold.tensile, moment, record.numbers)
        if because and alloy not in self._by_nodes:
            self._by_nodes.add(alloy)
            self.progress.note(f"{alloy}: damage is interpolated between the nodes: {because}")
        return record

    def pull(self, tests: Iterable[Test]) -> list[StageRecord]:
        """Tensile tests of alloys after immersion times held in some ways, several at a time."""
        tests = list(dict.fromkeys(tests))
        self._warn(tests)
        return self._pull(tests)

    def _pull(self, tests: list[Test]) -> list[StageRecord]:
        jobs = self._jobs(tests)
        how = self._how_to_pull()
        how["workers"] = min(self.workers, max(1, len(jobs)))
        run = run_jobs_here if self.pull_here else run_jobs
        run(jobs, **how)
        records = [self.folder.read_record(self._place(test), "pull") for test in tests]
        return [record for record in records if record is not None]

    def _warn(self, tests: Iterable[Test]) -> None:
        """Say what cells that were asked for get wrong; end faces have their own, as published."""
        from pipeline.planning.locking import locking

        asked = self.scene.tensile.element
        for hold in dict.fromkeys(test[2] for test in tests):
            for _, why, error in locking(hold.tensile) if hold.tensile.element == asked else ():
                self.progress.note(f"{why}: {error}; better --element P2")

    def _jobs(self, tests: Iterable[Test], mapped: bool = True) -> dict[str, TensileJob]:
        """The tests that are not complete, by key; their records are dropped.

        mapped: whether the map stage of each must be complete.
        """
        jobs: dict[str, TensileJob] = {}
        for test in tests:
            alloy, moment, hold = test
            key, folder = f"pull {alloy} {moment.label} {hold.name}", self._place(test)
            self._keys[key] = test
            if mapped:
                self._needs("map", folder, map_hash(self.scene, *test))
            inputs = pull_hash(self.scene, *test)
            if self.folder.complete(folder, "pull", inputs):
                self.progress.reused(key)
                continue
            self._say_damage("pull", folder, inputs)
            self.folder.forget(folder, "pull")
            jobs[key] = TensileJob(
                geometry=str(self.folder.geometry / self.scene.mesh_folder(hold)),
                damage=str(folder),
                out=str(folder),
                material=self.scene.alloy(alloy).material,
                tensile=hold.tensile,
            )
        return jobs

    def _how_to_pull(self) -> dict[str, object]:
        """Processes and observers of tests (PullQueue)."""
        return {
            "ranks": self.ranks,
            "workers": self.workers,
            "started": self.progress.started,
            "advanced": self.progress.advanced,
            "finished": self._pulled_in,
            "keep": self.folder.descriptors,
            "crew": self.crew,
        }

    def _pulled_in(self, key: str, seconds: float) -> None:
        """Write the record of a test that has ended."""
        test = self._keys[key]
        folder = self._place(test)
        outcome = (written_files(folder), read_result(folder))
        self._complete("pull", folder, pull_hash(self.scene, *test), seconds, outcome)
        if str(outcome[1]["status"]).startswith("stopped"):
            self.progress.note(f"{key}: {outcome[1]['status']}; its peak is a lower bound")
        self.progress.finished(key, seconds, self._found(test, outcome[1]))

    def _found(self, test: Test, pulled: dict) -> str:
        """The peak of a test and, where the intact solid's is known, the share that is left."""
        alloy, _, hold = test
        load = LOADS[self.scene.tensile.load]
        found = load.shown(pulled[f"peak_{load.reaction}"])
        intact = (alloy, self.scene.with_intact()[0], hold)
        if test == intact:
            return found
        record = self.folder.complete(self._place(intact), "pull", pull_hash(self.scene, *intact))
        if record is None:
            return found
        left = pulled[f"peak_{load.reaction}"] / record.numbers[f"peak_{load.reaction}"]
        return f"{found}, {100 * left:.0f} % left"

    def summarise(self) -> list[SummaryRow]:
        """Write summary.csv from the finished stages and return its rows."""
        rows = []
        intact = self.scene.with_intact()[0]
        load = self.scene.tensile.load
        peak, strain = f"peak_{LOADS[load].reaction}", LOADS[load].strain_at_peak
        for alloy in self.scene.alloys:
            corrosion = self._needs(
                "corrode", self.folder.corrosion(alloy.name), corrosion_hash(self.scene, alloy.name)
            )
            losses = corrosion.numbers["volume_loss"]
            unknown = [None] * len(losses)
            rates = corrosion.numbers.get("degradation_rate", unknown)  # mm/year
            for hold in self.scene.holds:
                reference = self._pulled((alloy.name, intact, hold))[peak]
                for moment, loss, rate in zip(self.scene.with_intact(), losses, rates, strict=True):
                    if moment not in self.scene.immersion:
                        continue
                    test = (alloy.name, moment, hold)
                    mapped = self._needs("map", self._place(test), map_hash(self.scene, *test))
                    pulled = self._pulled(test)
                    rows.append(
                        SummaryRow(
                            alloy=alloy.name,
                            hold=hold.name,
                            immersion_days=moment.days,
                            volume_loss=float(loss),
                            mean_corrosion_damage=float(mapped.numbers["mean_corrosion_damage"]),
                            peak_reaction=pulled[peak],
                            strength_ratio=pulled[peak] / reference,
                            strain_at_peak=pulled[strain],
                            status=pulled["status"],
                            load=load,
                            degradation_rate=rate,
                        )
                    )
        write_summary(self.folder.summary_file, rows)
        return rows

    def report(self, again: bool = False) -> StageRecord:
        """The report in one HTML file; made again when a stage was, or when asked to."""
        from pipeline.report.report import write_report

        def work() -> Outcome:
            return [Path(write_report(self.folder.path))], {}

        if again:
            self.folder.forget(self.folder.path, "report")
        stages = sorted(path for path in self.folder.path.rglob("*.stage.json"))
        made = [path.read_text() for path in stages if path.name != "report.stage.json"]
        inputs = report_hash(self.scene, made)
        return self._do("report", "report", self.folder.path, inputs, work)

    def _place(self, test: Test) -> Path:
        alloy, moment, hold = test
        return self.folder.test(alloy, moment.label, hold.name)

    def _pulled(self, test: Test) -> dict:
        return self._needs("pull", self._place(test), pull_hash(self.scene, *test)).numbers

    def _needs(self, stage: str, folder: Path, inputs: str) -> StageRecord:
        """The record of an earlier stage; refuses to go on without it."""
        record = self.folder.complete(folder, stage, inputs)
        if record is None:
            where = folder.relative_to(self.folder.path)
            damage = self.folder.damage(folder, stage, inputs)
            because = f", {damage}" if damage else ""
            raise RunFolderError(
                f"stage '{stage}' of '{where}' is not complete in run folder "
                f"'{self.folder.path}'{because}; run `perilife {stage}` on it first"
            )
        return record

    def _do(
        self, stage: str, key: str, folder: Path, inputs: str, work: Callable[[], Outcome],
        found: Callable[[dict], str] = lambda numbers: "",
    ) -> StageRecord:  # fmt: skip
        """Do a stage unless it is complete, and write its record last.

        found: of the numbers of the record, what came out, in a few words.
        """
        record = self.folder.complete(folder, stage, inputs)
        if record is not None:
            self.progress.reused(key)
            return record
        folder.mkdir(parents=True, exist_ok=True)
        self._say_damage(stage, folder, inputs)
        self.folder.forget(folder, stage)
        self.progress.started(key)
        begin = time.perf_counter()
        outcome = work()
        interruption.check()
        seconds = time.perf_counter() - begin
        record = self._complete(stage, folder, inputs, seconds, outcome)
        self.progress.finished(key, seconds, found(outcome[1]))
        return record

    def _say_damage(self, stage: str, folder: Path, inputs: str) -> None:
        damage = self.folder.damage(folder, stage, inputs)
        if damage:
            self.progress.note(f"{damage}; stage '{stage}' is done again")

    def _complete(
        self, stage: str, folder: Path, inputs: str, seconds: float, outcome: Outcome
    ) -> StageRecord:
        outputs, numbers = outcome
        record = StageRecord(
            stage=stage,
            inputs=inputs,
            seconds=round(seconds, 3),
            finished=utc_now(),
            outputs=self.folder.fingerprints(outputs),
            numbers=numbers,
            versions=machine.package_versions(),
        )
        self.folder.write_record(folder, record)
        return record

"""Environment of the tests: one thread per MPI rank, no screen, ranks allowed anywhere."""

import os
import shutil
import tempfile

# Set before NumPy, PETSc or VTK is imported by a test module.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# Waiting threads give way: on a busy machine spinning ones cost a hundredfold.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("PYVISTA_OFF_SCREEN", "true")
# `mpirun -n 2` must also start in a container: as root, and on a machine with a single core.
os.environ.setdefault("OMPI_ALLOW_RUN_AS_ROOT", "1")
os.environ.setdefault("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1")
os.environ.setdefault("OMPI_MCA_rmaps_base_oversubscribe", "1")

LONGEST = (
    "tests/end_to_end/test_coarse_run.py",
    "tests/peri/corrosion/interface/test_faradaic.py",
    "tests/peri/parallel/test_ranks.py",
    "tests/pipeline/test_cli_prints.py",
    "tests/peri/corrosion/test_run.py",
    "tests/pipeline/geometry/test_solids.py",
    "tests/extreme/test_tensile_extreme.py",
    "tests/pipeline/stages/test_pulls.py",
    "tests/peri/coupled/test_galvanic_ranks.py",
    "tests/pipeline/scenes/test_on_ranks.py",
)
"""Files that begin first, so that what begins last is short and no process waits for another."""


def pytest_configure(config) -> None:
    """One folder for the surfaces of all tests, whichever process computes them first."""
    if hasattr(config.option, "loadscopereorder"):  # xdist 3.8; before, the files with most tests
        config.option.loadscopereorder = False  # come first
    if not hasattr(config, "workerinput") and "PERILIFE_SURFACES" not in os.environ:
        os.environ["PERILIFE_SURFACES"] = config.surfaces = tempfile.mkdtemp(prefix="perilife-")


def pytest_unconfigure(config) -> None:
    """Surfaces of a session do not outlive it."""
    if hasattr(config, "surfaces"):
        shutil.rmtree(config.surfaces, ignore_errors=True)


def pytest_collection_modifyitems(items) -> None:
    """The longest files first, the others in their order."""
    place = {name: number for number, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.nodeid.partition("::")[0], len(place)))

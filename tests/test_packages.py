"""What is installed, and what of it does without dolfinx."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from pipeline.benches.empty_environment import copied_sources

ROOT = Path(__file__).resolve().parent.parent
SOLVED_BY_DOLFINX = {
    "fem.assembly", "fem.compat", "fem.discretisation", "fem.loading", "fem.multigrid",
    "fem.newton", "fem.outcome", "fem.preparation", "fem.settings", "fem.solvers", "fem.strength",
    "fem.tearing", "fem.two_levels",
}  # fmt: skip
ON_RANKS = {
    "peri.corrosion.ranks", "peri.coupled.galvanic_ranks", "peri.parallel.multigrid",
    "peri.parallel.ranks",
}  # fmt: skip

IMPORT_ALL = """
import importlib, pkgutil, sys
for name in ("dolfinx", "ufl", "basix", "ffcx", "petsc4py", "slepc4py", "mpi4py"):
    sys.modules[name] = None
import fem, peri, perilife_data, pipeline
for package in (fem, peri, perilife_data, pipeline):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        try:
            importlib.import_module(module.name)
        except ImportError:
            print(module.name)
"""

USE = """
import sys, perilife
from pipeline.api.life_cycle import LifeCycle
import fem, peri, perilife_data, pipeline.report
assert perilife.LifeCycle is LifeCycle
for module in (perilife, fem, peri, perilife_data, pipeline):
    print(module.__file__)
print(perilife_data.list_alloys(), (perilife_data.load_reference("hermann2024").key))
"""


def run_python(code: str, *path: Path) -> str:
    """What a Python without the settings of this one prints."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    if path:
        environment["PYTHONPATH"] = os.pathsep.join(map(str, path))
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=path[0] if path else ROOT,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_only_the_tensile_test_and_marches_on_ranks_need_dolfinx_or_mpi() -> None:
    assert set(run_python(IMPORT_ALL).split()) == SOLVED_BY_DOLFINX | ON_RANKS


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of this checkout, built from a copy of its files and unpacked."""
    place = tmp_path_factory.mktemp("wheel")
    source = copied_sources(place / "source")
    command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation"]
    subprocess.run([*command, "-w", str(place), str(source)], check=True, capture_output=True)
    (wheel,) = place.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(place / "site-packages")
    return place / "site-packages"


@pytest.mark.slow
def test_the_wheel_takes_one_name_and_has_every_file(unpacked: Path) -> None:
    top = {path.name for path in unpacked.iterdir() if not path.name.endswith(".dist-info")}
    assert top == {"perilife"}
    packages = {path.name for path in (unpacked / "perilife/packages").iterdir()}
    assert packages == {"fem", "peri", "perilife_data", "pipeline"}
    for folder, name in (("peri", "peri"), ("fem", "fem"), ("pipeline", "pipeline"),
                         ("data", "perilife_data")):  # fmt: skip
        kinds = (".py", ".toml", ".bib", ".csv", ".js", ".j2", ".typed")
        for path in (ROOT / folder).rglob("*"):
            shown = path.parent.name == "examples"
            shown |= path.parent.name == "studies" and path.suffix != ".py"
            if path.suffix in kinds and not shown:  # only a reader opens those
                installed = unpacked / "perilife/packages" / name / path.relative_to(ROOT / folder)
                assert installed.read_bytes() == path.read_bytes()


@pytest.mark.slow
def test_what_the_wheel_installs_is_found_before_what_else_has_its_names(
    unpacked: Path, tmp_path: Path
) -> None:
    for name in ("pipeline", "fem"):  # another distribution's
        (tmp_path / f"{name}.py").write_text("raise ImportError('not this one')\n")
    lines = run_python(USE, unpacked, tmp_path).splitlines()
    assert len(lines) == 6 and all(line.startswith(str(unpacked)) for line in lines[:5])
    assert "Mg-5Gd" in lines[5] and "hermann2024" in lines[5]

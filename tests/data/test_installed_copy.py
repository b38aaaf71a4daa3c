"""An installed copy, not the checkout, finds its data files and pollutes nothing."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import perilife_data

ROOT = Path(__file__).resolve().parents[2]
PLACE = "perilife/packages"
"""Where the packages lie in site-packages (setup.py says why)."""

ASK_THE_COPY = """
import json, sys
sys.path.insert(0, sys.argv[1])
import perilife
import perilife_data
print(json.dumps({
    "folder": perilife_data.__path__[0],
    "alloys": {name: perilife_data.load_alloy(name).solid_concentration.si
               for name in perilife_data.list_alloys()},
    "media": perilife_data.list_media(),
    "parameter_sets": perilife_data.list_parameter_sets(),
}))
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install a copy of the sources (the build writes beside them) into an empty folder."""
    source, target = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("target")
    for name in ("pyproject.toml", "setup.py", "LICENSE"):
        shutil.copy(ROOT / name, source)
    for name in ("peri", "perilife", "fem", "pipeline", "data", "tests"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    if (ROOT / "README.md").exists():
        shutil.copy(ROOT / "README.md", source)
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    command += ["--no-build-isolation", "--target", str(target), str(source)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return target


def test_only_one_name_and_the_command_are_installed(installed: Path) -> None:
    names = {path.name for path in installed.iterdir() if path.suffix != ".dist-info"}
    assert names == {"perilife", "bin"}
    packages = {path.name for path in (installed / PLACE).iterdir()}
    assert packages == {"peri", "fem", "pipeline", "perilife_data"}
    assert [path.name for path in (installed / "bin").iterdir()] == ["perilife"]


@pytest.mark.parametrize("package", ["peri", "fem", "pipeline"])
def test_every_module_of_the_checkout_is_installed(installed: Path, package: str) -> None:
    modules = {path.relative_to(ROOT) for path in (ROOT / package).rglob("*.py")}
    modules = {path for path in modules if path.parent.name != "examples"}  # a reader opens those
    assert len(modules) >= 3
    assert {path for path in modules if not (installed / PLACE / path).exists()} == set()


@pytest.mark.parametrize("files", ["pipeline/report/templates/*", "pipeline/scene/*.toml"])
def test_the_files_beside_the_modules_are_installed(installed: Path, files: str) -> None:
    found = {path.relative_to(ROOT) for path in ROOT.glob(files)}
    assert len(found) >= 1
    assert {path for path in found if not (installed / PLACE / path).exists()} == set()


def test_the_copy_reads_its_own_data(installed: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-I", "-c", ASK_THE_COPY, str(installed)],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer == {
        "folder": str(installed / PLACE / "perilife_data"),
        "alloys": {
            name: perilife_data.load_alloy(name).solid_concentration.si
            for name in perilife_data.list_alloys()
        },
        "media": perilife_data.list_media(),
        "parameter_sets": perilife_data.list_parameter_sets(),
    }

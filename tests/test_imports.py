"""The house rules on imports and output, read from the sources of all packages.

peri, fem and data (imported as perilife_data) know nothing of one another; only pipeline joins
them. dolfinx stays in fem, gmsh in pipeline/geometry, and libraries neither print nor
touch the root logger. Within a package a room (a folder, or a file at its top) imports only from
the rooms that BELOW names; large rooms have rooms of their own, under the same rule.
"""

import ast
import functools
from collections.abc import Container
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = {"peri": "peri", "fem": "fem", "pipeline": "pipeline", "data": "perilife_data"}
"""Folder in the checkout -> name under which it is imported."""

DOLFINX = {"dolfinx", "ufl", "basix", "ffcx"}
PARALLEL = {"petsc4py", "slepc4py", "mpi4py"}
LIBRARIES = ("peri", "fem", "data")
THIRD_PARTY = {
    "peri": {"numpy", "scipy", "numba", "h5py"},
    "fem": {"numpy", "scipy", "numba", "h5py"} | DOLFINX | PARALLEL,
    "data": {"numpy"},
}
"""What the libraries may import besides the standard library and themselves."""

MORE_ALLOWED = {
    "peri/parallel/ranks.py": PARALLEL,
    "peri/parallel/multigrid.py": PARALLEL,
    "peri/corrosion/ranks.py": PARALLEL,
    "peri/coupled/galvanic_ranks.py": PARALLEL,
    "peri/corrosion/results.py": {"pyvista"},
    "fem/results.py": {"pyvista"},
}
"""The files of peri that reach MPI and PETSc, and the files that write VTK."""

GMSH = "pipeline/geometry/"

BELOW = {
    "peri": {
        "engine": set(),
        "parallel": {"engine"},
        "reference": {"engine"},
        "schemes": {"engine"},
        "transport": {"engine"},
        "corrosion": {"engine", "parallel"},
        "coupled": {"engine", "parallel", "transport", "corrosion"},
        "omissions": {"engine", "corrosion", "coupled"},
    },
    "peri.engine": {
        "cells": set(),
        "compiled": set(),
        "constants": set(),
        "hashing": set(),
        "lattice": set(),
        "omission": set(),
        "processes": set(),
        "choices": set(),
        "influence": {"choices", "lattice"},
        "kernels": {"compiled"},
        "multigrid_kernels": {"compiled"},
        "results": {"lattice"},
        "multigrid": {"multigrid_kernels"},
        "operators": {"influence", "kernels", "processes"},
        "walls": {"influence", "operators"},
        "solvers": {"kernels", "multigrid", "operators", "walls"},
        "march": {"processes", "solvers"},
        "surface": {"influence", "lattice"},
    },
    "peri.corrosion": {
        "choices": set(),
        "coating": set(),
        "kinetics": set(),
        "settling": set(),
        "acidity": {"kinetics"},
        "electrode_kinetics": {"kinetics"},
        "inhibition": {"kinetics"},
        "liquid_factors": {"kinetics"},
        "passivity": {"kinetics"},
        "polarization": {"kinetics"},
        "rate_laws": {"acidity", "kinetics", "passivity"},
        "metal": {"kinetics"},
        "laws": {"choices", "metal"},
        "scene": {"choices", "coating", "kinetics", "laws", "metal"},
        "blocks": {"scene"},
        "phases": {"blocks", "scene"},
        "interface": {"laws", "metal", "phases", "scene"},
        "nodes": {"interface", "kinetics", "metal", "phases", "scene", "settling"},
        "classes": {"blocks", "interface", "kinetics", "nodes", "scene", "settling"},
        "run": {"classes", "nodes", "scene"},
        "ranks": {"run", "scene"},
        "results": {"nodes", "run"},
    },
    "peri.transport": {
        "liquid": set(),
        "mixing": set(),
        "fluxes": set(),
        "permittivity": set(),
        "potential": set(),
        "options": {"fluxes"},
        "chemistry": {"liquid"},
        "migration": {"chemistry", "fluxes", "liquid"},
        "nernst_planck": {
            "chemistry",
            "fluxes",
            "liquid",
            "migration",
            "options",
            "permittivity",
            "mixing",
        },
        "stored": {"chemistry", "fluxes", "liquid", "mixing", "nernst_planck"},
        "reservoirs": {"chemistry", "fluxes", "liquid", "nernst_planck", "options"},
    },
    "pipeline": {
        "scene": set(),
        "geometry": {"scene"},
        "record": {"scene"},
        "stages": {"scene", "geometry", "record"},
        "planning": {"scene", "geometry", "record", "stages"},
        "report": {"scene", "geometry", "record", "stages", "planning"},
        "studies": {"scene", "geometry", "record", "stages", "calibration", "scenes"},
        "calibration": {"scene", "geometry", "record", "stages"},
        "export": {"scene", "geometry", "record", "stages"},
        "compare": {"scene", "record", "report"},
        "measured": {"scene", "geometry", "record", "stages", "export"},
        "completion": set(),
        "scenes": {"scene", "geometry", "record", "stages", "planning"},
        "life_cycle": {"scene", "geometry", "record", "stages", "planning", "report"},
        "campaigns": {
            "scene",
            "geometry",
            "record",
            "stages",
            "planning",
            "calibration",
            "life_cycle",
        },  # fmt: skip
        "benches": {
            "scene",
            "geometry",
            "record",
            "stages",
            "planning",
            "studies",
            "calibration",
            "life_cycle",
            "campaigns",
            "export",
            "compare",
            "scenes",
        },
        "known": set(),
        "run": {"scene", "record", "stages", "planning", "report", "life_cycle", "campaigns"},
        "examples": set(),
        "api": {"scene", "record", "stages", "planning", "report", "export", "run"},
        "cli": {
            "scene",
            "record",
            "stages",
            "planning",
            "studies",
            "calibration",
            "life_cycle",
            "campaigns",
            "benches",
            "export",
            "known",
            "run",
            "compare",
            "completion",
            "scenes",
            "measured",
        },
    },
}
"""Package -> room -> the rooms that it may import from, besides itself."""

STANDARD_LIBRARY = frozenset(__import__("sys").stdlib_module_names)


@dataclass(frozen=True)
class Source:
    """What the rules want to know of a file; its syntax tree is read once.

    path : below root.  imports : of each import the level, the module and the names taken from it
    (None for `import module`).  calls : line and dotted name of every call, and whether it has
    positional arguments.
    """

    path: str
    imports: list[tuple[int, str, list[str] | None]]
    calls: list[tuple[int, str, bool]]


def read(root: Path, path: Path) -> Source:
    """Read one file."""
    source = Source(path.relative_to(root).as_posix(), [], [])
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            source.imports.extend((0, alias.name, None) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            names = [alias.name for alias in node.names]
            source.imports.append((node.level, node.module or "", names))
        elif isinstance(node, ast.Call):
            source.calls.append((node.lineno, dotted(node.func), bool(node.args)))
    return source


def dotted(function: ast.expr) -> str:
    """Return a name such as logging.getLogger; empty for what is not a plain one."""
    if isinstance(function, ast.Attribute):
        owner = dotted(function.value)
        return f"{owner}.{function.attr}" if owner else ""
    return function.id if isinstance(function, ast.Name) else ""


@functools.cache
def sources(root: Path, folder: str) -> tuple[Source, ...]:
    """Return every Python file of a folder; the files are read once and not looked at again."""
    return tuple(read(root, path) for path in sorted((root / folder).rglob("*.py")))


def module_name(path: str) -> str:
    """Return the import name of a file, such as peri.corrosion.kinetics or perilife_data."""
    folder, *rest = Path(path).with_suffix("").parts
    return ".".join([FOLDERS[folder], *(part for part in rest if part != "__init__")])


def imported_modules(source: Source, known: Container[str] = ()) -> set[str]:
    """Return the absolute names of all modules a file imports, wherever the import stands.

    `from a import b` counts as a.b where that is a known module, as a otherwise.
    """
    package = module_name(source.path).split(".")
    if Path(source.path).name != "__init__.py":
        package = package[:-1]
    found: set[str] = set()
    for level, target, names in source.imports:
        base = package[: len(package) - level + 1] if level else []
        module = ".".join([*base, *([target] if target else [])])
        full = [f"{module}.{name}" for name in names or ()]
        found |= {module} if names is None else {n if n in known else module for n in full}
    return found


def top_names(source: Source) -> set[str]:
    """Return the packages that a file imports."""
    return {name.split(".")[0] for name in imported_modules(source)}


def foreign_imports(root: Path) -> list[str]:
    """Return what a library imports beyond the standard library, itself and its allowed list."""
    found = []
    for folder in LIBRARIES:
        for source in sources(root, folder):
            path = source.path
            allowed = THIRD_PARTY[folder] | MORE_ALLOWED.get(path, set()) | {FOLDERS[folder]}
            if path.startswith("fem/constitutive/"):
                allowed = allowed - DOLFINX - PARALLEL  # testable without any of them
            beyond = top_names(source) - allowed - STANDARD_LIBRARY
            found += [f"{path}: {top}" for top in sorted(beyond)]
    return found


def misplaced_imports(root: Path) -> list[str]:
    """Return imports of dolfinx outside fem and of gmsh outside pipeline/geometry."""
    found = []
    for folder in FOLDERS:
        for source in sources(root, folder):
            path, tops = source.path, top_names(source)
            if folder != "fem":
                found += [f"{path}: {top}" for top in sorted(tops & DOLFINX)]
            if not path.startswith(GMSH) and "gmsh" in tops:
                found.append(f"{path}: gmsh")
    return found


def import_cycles(root: Path, folder: str) -> list[str]:
    """Return the modules of a package that, directly or through others, import themselves.

    They are those that share a strong component of the graph of imports, or import themselves.
    """
    named = {module_name(source.path): source for source in sources(root, folder)}
    number = {name: n for n, name in enumerate(named)}
    arrows = [
        (number[name], number[other])
        for name, source in named.items()
        for other in imported_modules(source, named) & named.keys()
    ]
    rows, columns = np.array(arrows, int).reshape(-1, 2).T
    graph = csr_matrix((np.ones(rows.size), (rows, columns)), (len(named), len(named)))
    _, component = connected_components(graph, directed=True, connection="strong")
    shared = np.bincount(component)[component] > 1
    shared[rows[rows == columns]] = True
    return [name for name, n in number.items() if shared[n]]


def room_in(house: str, module: str) -> str:
    """Return the room of a house (a package) that holds a module; empty where none does."""
    return module.removeprefix(house + ".").split(".")[0] if module.startswith(house + ".") else ""


def climbing_imports(root: Path) -> list[str]:
    """Return the imports between rooms of a package that BELOW does not allow."""
    found = []
    for house, rooms in BELOW.items():
        package = house.split(".")[0]
        if not (root / house.replace(".", "/")).is_dir():
            continue
        named = {module_name(source.path): source for source in sources(root, package)}
        for name, source in named.items():
            path, room = source.path, room_in(house, name)
            if room and room not in rooms:
                found.append(f"{path}: a room without a row")
                continue
            if not name.startswith(house):
                continue
            for other in sorted(imported_modules(source, named) & named.keys()):
                target = room_in(house, other)
                if target and target != room and target not in rooms.get(room, set()):
                    found.append(f"{path}: {other}")
    return found


def test_every_row_names_rooms_that_exist() -> None:
    for package, rooms in BELOW.items():
        there = {
            p.stem
            for p in (ROOT / package.replace(".", "/")).iterdir()
            if p.is_dir() or p.suffix == ".py"
        }
        named = set(rooms).union(*rooms.values())
        assert named <= there, (package, named - there)


def talking_libraries(root: Path) -> list[str]:
    """Return where a library prints or uses the root logger instead of its own."""
    root_logger = {"debug", "info", "warning", "error", "critical", "basicConfig"}
    root_logger = {f"logging.{name}" for name in root_logger}
    return [
        f"{source.path}:{line}: {name}"
        for folder in LIBRARIES
        for source in sources(root, folder)
        for line, name, named in source.calls
        if name in {"print"} | root_logger or (name == "logging.getLogger" and not named)
    ]


def pickles(root: Path) -> list[str]:
    """Return the files that import pickle or one of its relatives."""
    relatives = {"pickle", "dill", "joblib", "shelve", "marshal"}
    return [
        source.path
        for folder in FOLDERS
        for source in sources(root, folder)
        if relatives & top_names(source)
    ]


@pytest.mark.parametrize("folder", FOLDERS)
def test_every_package_has_sources(folder: str) -> None:
    assert len(sources(ROOT, folder)) >= 3


def test_libraries_import_only_what_is_theirs() -> None:
    assert foreign_imports(ROOT) == []


def test_dolfinx_only_in_fem_and_gmsh_only_in_geometry() -> None:
    assert misplaced_imports(ROOT) == []


@pytest.mark.parametrize("folder", FOLDERS)
def test_no_module_imports_itself_in_a_circle(folder: str) -> None:
    assert import_cycles(ROOT, folder) == []


def test_rooms_import_only_from_rooms_below() -> None:
    assert climbing_imports(ROOT) == []


def test_libraries_neither_print_nor_use_the_root_logger() -> None:
    assert talking_libraries(ROOT) == []


def test_no_pickles() -> None:
    assert pickles(ROOT) == []


BROKEN = {
    "peri/__init__.py": "",
    "peri/a.py": "from fem import strength\nprint('loud')\n",
    "peri/parallel/ranks.py": "from petsc4py import PETSc\n",
    "peri/engine/low.py": "from peri.corrosion.high import thing\n",
    "peri/corrosion/high.py": "from peri.engine.low import thing\nfrom peri.attic import old\n",
    "peri/attic/old.py": "",
    "peri/b.py": "def late():\n    from . import c\n",
    "peri/c.py": "from .b import late\nimport logging\nlogging.info('root')\n",
    "peri/sub/__init__.py": "from peri.sub.user import thing\n",
    "peri/sub/tool.py": "",
    "peri/sub/user.py": "from peri.sub import tool\nfrom peri.b import late as thing\n",
    "peri/sub2/__init__.py": "from .user import thing\n",
    "peri/sub2/user.py": "from peri.sub2 import thing\n",
    "fem/constitutive/d.py": "import dolfinx\nimport logging\nlogging.getLogger()\n",
    "pipeline/e.py": "import gmsh, ufl, fem, peri\nimport pickle\n",
    "pipeline/geometry/solids.py": "import gmsh\n",
    "data/f.py": "from perilife_data.units import to_si\nfrom peri.constants import F\n",
}


@pytest.mark.parametrize(
    ("rule", "expected"),
    [
        (foreign_imports, ["peri/a.py: fem", "fem/constitutive/d.py: dolfinx", "data/f.py: peri"]),
        (misplaced_imports, ["pipeline/e.py: ufl", "pipeline/e.py: gmsh"]),
        (
            lambda root: import_cycles(root, "peri"),
            [
                "peri.b",
                "peri.c",
                "peri.corrosion.high",
                "peri.engine.low",
                "peri.sub2",
                "peri.sub2.user",
            ],
        ),
        (
            talking_libraries,
            [
                "peri/a.py:2: print",
                "peri/c.py:3: logging.info",
                "fem/constitutive/d.py:3: logging.getLogger",
            ],
        ),
        (
            climbing_imports,
            [
                "peri/a.py: a room without a row",
                "peri/attic/old.py: a room without a row",
                "peri/b.py: a room without a row",
                "peri/c.py: a room without a row",
                "peri/corrosion/high.py: peri.attic.old",
                "peri/engine/low.py: peri.corrosion.high",
                "peri/sub/__init__.py: a room without a row",
                "peri/sub/tool.py: a room without a row",
                "peri/sub/user.py: a room without a row",
                "peri/sub2/__init__.py: a room without a row",
                "peri/sub2/user.py: a room without a row",
                "peri/engine/low.py: a room without a row",
                "peri/corrosion/high.py: a room without a row",
                "pipeline/e.py: a room without a row",
            ],
        ),
        (pickles, ["pipeline/e.py"]),
    ],
)
def test_each_rule_finds_what_breaks_it(rule, expected: list[str], tmp_path: Path) -> None:
    for path, text in BROKEN.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text, encoding="utf-8")
    assert rule(tmp_path) == expected

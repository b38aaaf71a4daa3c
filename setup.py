"""Which packages are installed, and where; everything else is in pyproject.toml.

`perilife` is the only name in site-packages: the packages lie in `perilife/packages` under the
names that they have in a checkout (`data` as `perilife_data`), as `perilife/__init__.py` explains.
An editable installation, which puts nothing into site-packages but the way to the checkout, has
them at the top. `tests/` is not installed.
"""

import sys

from setuptools import find_packages, setup

PLACE = "" if "editable_wheel" in sys.argv else "perilife.packages."
NAMES = {"peri": "peri", "fem": "fem", "pipeline": "pipeline", "data": "perilife_data"}
"""Folder of the checkout -> name under which it is imported."""

FILES = {
    "perilife_data": ["*.toml", "*.bib", "*/*.toml", "*/*.csv"],
    "peri": ["py.typed"],
    "pipeline.report": ["templates/*"],
    "pipeline.scene": ["*.toml"],
    "pipeline.scenes": ["shipped/*.toml"],
}
"""What else than Python lies in a package."""

folders = {"perilife": "perilife"}
for folder, name in NAMES.items():
    for package in find_packages(include=[folder, f"{folder}.*"]):
        folders[PLACE + name + package.removeprefix(folder)] = package.replace(".", "/")

setup(
    packages=list(folders),
    package_dir=folders,
    package_data={PLACE + name: files for name, files in FILES.items()},
)

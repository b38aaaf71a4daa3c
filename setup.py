"""Which packages are installed, and under which names; everything else is in pyproject.toml.

`data/` is a good name in a checkout and a bad one in site-packages, so it is installed as
`perilife_data`. `tests/` is not installed.
"""

from setuptools import find_packages, setup

setup(
    packages=[
        *find_packages(include=["peri", "peri.*", "fem", "fem.*", "pipeline", "pipeline.*"]),
        "perilife_data",
    ],
    package_dir={"perilife_data": "data"},
    package_data={
        "perilife_data": ["*.toml", "*.bib", "*/*.toml", "*/*.csv"],
        "peri": ["py.typed"],
        "pipeline.report": ["templates/*"],
        "pipeline.scene": ["*.toml"],
    },
)

"""What CONTRIBUTING.md tells to do works as told."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from peri.corrosion import kinetics, rate_laws
from peri.corrosion.laws import INTERFACE_LAWS
from pipeline.scene.laws import rate_law
from tests.peri.corrosion.test_laws import check_law, check_slows

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def passivation():
    """The class in the text."""
    text = (ROOT / "CONTRIBUTING.md").read_text()
    code = re.search(r"```python\n(.*?)```", text, re.S).group(1)
    names = {"__name__": "tests.of_contributing"}
    sys.modules.setdefault("tests.of_contributing", type(sys)("tests.of_contributing"))
    exec(compile(code, "CONTRIBUTING.md", "exec"), names)
    return names["Passivation"]


@pytest.mark.parametrize("bond", INTERFACE_LAWS)
def test_the_law_of_twenty_lines_keeps_the_invariants(passivation, bond, tmp_path):
    law = passivation(3e5)
    check_law(law, bond, tmp_path)
    check_slows(law)
    rates = law.rate(kinetics.Exposed(age=np.array([0.0, 3e5])))
    np.testing.assert_allclose(rates, [1.0, 0.1 + 0.9 / np.e])


def test_a_row_is_all_that_the_command_line_needs(passivation, monkeypatch):
    monkeypatch.setitem(rate_laws.KINETICS, "passivation", passivation)
    numbers = rate_law.numbers_of("passivation")
    assert numbers == ("time", "residual?")
    monkeypatch.setitem(rate_law.KINETICS, "passivation", numbers)
    assert rate_law.read_kinetics("passivation:time=86400") == ("passivation", {"time": 86400.0})
    with pytest.raises(ValueError, match="the numbers of passivation must be time, residual"):
        rate_law.read_kinetics("passivation:residual=0.2")


def test_names_and_choices_are_read_without_the_compiled_solvers():
    """numba takes a second to import, which no `--help` should wait for."""
    code = (
        "import sys, peri.corrosion.rate_laws, peri.corrosion.laws, peri.corrosion.choices\n"
        "import peri.engine.omission, peri.omissions.names, pipeline.scene.command.options\n"
        "print([m for m in ('numba', 'scipy', 'h5py') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"

"""Profiles beside a dissolving metal against PHREEQC's own transport (TRANSPORT -multi_d)."""

import numpy as np
import pytest

from tests.peri.transport import phreeqc
from tests.peri.transport.chemistries import SALINE, SBF, chemistry
from tests.peri.transport.columns import column

LENGTH, CELLS, FLUX = 0.5e-3, 6, 1e-6


@pytest.mark.slow
@pytest.mark.parametrize(("name", "totals", "at_rest"), [("nacl", SALINE, 7.0), ("sbf", SBF, 7.66)])
def test_profiles_equal_those_of_phreeqc(name: str, totals: dict, at_rest: float) -> None:
    chem = chemistry(name, 25.0)
    rows = phreeqc.dissolution(chem, totals, FLUX, LENGTH, CELLS)
    ph, magnesium = (np.array([row[key] for row in rows]) for key in ("pH", "Mg"))
    # Its cells end half a spacing from the medium: they lie on every second of our nodes.
    liquid, unit = column(chem, totals, 2 * CELLS - 1, LENGTH, 1)
    state = liquid.solve(FLUX * unit)
    e = chem.components.index("Mg")
    ours = (chem.stoichiometry[:, e] @ state.concentration)[::2]
    assert liquid.medium.ph[0] == pytest.approx(at_rest, abs=0.01)
    assert ph[0] > at_rest + 0.15
    # PHREEQC adds the slope of ln gamma to the diffusion.  Measured: 1.5e-4 in saline (1e-5 in
    # SBF), 0.14 % (0.11 %).
    assert liquid.ph(state)[::2] == pytest.approx(ph, abs=1e-3)
    assert ours == pytest.approx(magnesium, rel=3e-3)
    assert max(abs(row["charge"]) for row in rows) < 1e-6

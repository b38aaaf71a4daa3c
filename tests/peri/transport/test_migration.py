"""What migration adds to the components of a liquid, against the sum over the bonds of each ion."""

import numpy as np
import pytest

from peri.transport.fluxes import migration
from peri.transport.migration import Migration
from tests.peri.transport.chemistries import SBF, chemistry
from tests.peri.transport.columns import column


@pytest.mark.parametrize("form", ["sqra", "sg", "mean"])
def test_components_carry_what_their_ions_carry(form: str) -> None:
    chem = chemistry("sbf")
    liquid, unit = column(chem, SBF, 40)
    state, space = liquid.solve(3e-6 * unit), liquid.space
    psi = 50.0 * state.psi  # up to a tenth of RT/F
    found = Migration(form, space, chem).inflow(state.concentration, liquid.edge, psi)
    wanted = np.zeros_like(found)
    for k, (c, edge) in enumerate(zip(state.concentration, liquid.edge, strict=True)):
        fields = space.spread(c, edge), space.spread(psi)
        moved = migration(form, space.sum, space.all_volume, *fields, chem.charge[k])
        wanted += np.multiply.outer(
            chem.stoichiometry[k] * chem.diffusivity[k], space.gather(moved)
        )
    assert np.abs(wanted).min(axis=1).max() > 0
    assert found == pytest.approx(wanted, abs=1e-10 * np.abs(wanted).max())

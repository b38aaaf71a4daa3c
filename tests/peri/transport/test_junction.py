"""The potential of a liquid junction: salt of ten to one, whose front is resolved."""

import numpy as np
import pytest

from tests.peri.transport.chemistries import without
from tests.peri.transport.test_stored import vessel

THERMAL = 25.6926
"""R T / F at 25 degC, mV."""


def test_a_junction_of_ten_to_one() -> None:
    chem = without("nacl", ("MgOH",), 25.0)
    nodes = 160
    # A closed vessel of 0.5 mm; the front is ten spacings wide (one sharper than a bond has another
    # potential) and far from both ends.
    liquid, _ = vessel(chem, {"Na": 100.0, "Cl": 100.0}, nodes, 1, activity="ideal")
    state = liquid.rest()
    share = 0.55 - 0.45 * np.tanh((np.arange(nodes) - 0.5 * (nodes - 1)) / 10.0)
    content, weighted = liquid.content(state), chem.diffusivity * liquid.edge
    for name in ("Na", "Cl"):
        e = chem.components.index(name)
        content[e] *= share
        state.ln_component[e] += np.log(share)
        state.migrated[e] = weighted[e] * (share - 1.0)
    none = np.zeros((len(liquid.minerals), nodes))
    for _ in range(2):
        state = liquid.advance(np.zeros(nodes), content, 0.01, state, none)
        content = liquid.conserved(state, np.zeros(nodes), content, 0.01)
    volt = THERMAL * (state.psi[0] - state.psi[-1])
    plus, minus = chem.diffusivity[chem.index("Na")], chem.diffusivity[chem.index("Cl")]
    exact = THERMAL * (minus - plus) / (minus + plus) * np.log(10.0)
    assert exact == pytest.approx(12.325, abs=1e-3)
    # Of second order in spacing over width: 0.014 off with six spacings, 0.0057 with ten.
    assert volt == pytest.approx(exact, abs=0.01)

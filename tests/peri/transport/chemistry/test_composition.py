"""The composition of a node from its totals: compiled against plain arithmetic."""

import numpy as np
import pytest

from peri.transport.chemistry import composition
from peri.transport.chemistry.composition import Composer
from peri.transport.chemistry.species import MOLAR
from tests.peri.transport.chemistries import SBF, chemistry


def composed() -> tuple[Composer, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """SBF with ever more acid: composer, weighted totals, b, ln components, concentrations."""
    chem = chemistry("sbf")
    composer = Composer(chem.stoichiometry, chem.diffusivity)
    totals = chem.totals({**SBF, "Mg": 1.0, "OH": 2.0})[:, None] * np.ones(20)
    totals[chem.components.index("H")] *= np.linspace(0.8, 1.2, 20)
    weighted = totals * chem.diffusivity.mean()
    b = chem.ln_k[:, None] + np.log(MOLAR) * (1.0 - chem.stoichiometry.sum(axis=1))[:, None]
    m = np.full(totals.shape, -5.0)
    return composer, weighted, b, m, composer.solve(weighted, b, m)


def test_what_is_returned_is_the_composition_of_the_components_found() -> None:
    chem = chemistry("sbf")
    _, target, b, m, found = composed()
    # The last Newton step enters by a series: measured 1e-15.
    assert found == pytest.approx(np.exp(b + chem.stoichiometry @ m), rel=1e-13)
    weighted = chem.diffusivity[:, None] * found
    size = np.abs(chem.stoichiometry).T @ weighted
    assert np.abs(chem.stoichiometry.T @ weighted - target).max() < 1e-13 * size.max()


def test_sensitivity_to_what_a_mineral_takes_equals_the_dense_inverse() -> None:
    chem = chemistry("sbf")
    composer, _, _, _, found = composed()
    taken = np.zeros(len(chem.components))
    taken[[chem.components.index("Ca"), chem.components.index("CO3")]] = 1.0, 1.0
    taken[chem.components.index("H")] = -1.0
    weighted = chem.diffusivity[:, None] * found
    dense = [
        taken @ np.linalg.solve(chem.stoichiometry.T @ (w[:, None] * chem.stoichiometry), taken)
        for w in weighted.T
    ]
    assert composer.sensitivity(found, taken) == pytest.approx(dense, rel=1e-9)
    assert (np.asarray(dense) > 0).all()


def test_blocks_compose_as_one_does(monkeypatch: pytest.MonkeyPatch) -> None:
    composer, target, b, m, found = composed()
    monkeypatch.setattr(composition, "_BLOCK", 8)
    started, out = np.full(m.shape, -5.0), np.empty_like(found)
    composer.fill(lambda nodes: target[:, nodes], b, started, out)
    assert (out == found).all() and (started == m).all()
    target[chemistry("sbf").components.index("Ca"), [2, 18]] = -1.0
    with pytest.raises(composition.CompositionError, match="2 of 20 nodes have none.* is -1"):
        composer.solve(target, b, np.full(m.shape, -5.0))

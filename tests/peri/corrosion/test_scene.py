"""What a scene derives from its input, and what it refuses."""

import numpy as np
import pytest

from peri.corrosion.nodes.bimaterial import BiMaterial
from peri.corrosion.scene import CorrosionScene
from peri.engine.lattice import Lattice, ball, box_lattice
from tests.peri.corrosion.scenes import pin

LATTICE = Lattice((0.0, 0.0), (0.1, 0.1), (5, 6))
METAL = np.zeros((5, 6), bool)
METAL[2, 2:4] = True


def scene(**options):
    settings = {"horizon": 0.2, "metal": METAL, "interface_diffusivity": 1e-12, **options}
    return CorrosionScene(settings.pop("lattice", LATTICE), **settings)


FRACTION = np.full((5, 6), 0.5)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"metal": METAL.astype(float)}, "metal: float64"),
        ({"metal": METAL[:4]}, "metal: bool"),
        ({"domain": METAL.astype(int)}, "domain: int64"),
        ({"domain": ~METAL}, "metal: it must lie inside the domain"),
        ({"metal_fraction": FRACTION[:4]}, "metal_fraction"),
        ({"metal_fraction": 3 * FRACTION}, "metal_fraction"),
        ({"metal_fraction": -FRACTION}, "metal_fraction"),
        ({"metal_fraction": np.nan * FRACTION}, "metal_fraction"),
        ({"boundary": "open"}, "boundary: 'open'; allowed: refreshed, no_flux"),
        ({"saturation": "some"}, "saturation: 'some'; allowed: complementarity, as_published"),
        ({"solid_concentration": 0.0}, "solid_concentration"),
        ({"solid_concentration": float("inf")}, "solid_concentration"),
        ({"saturation_concentration": 0.0}, "saturation_concentration"),
        ({"saturation_concentration": -1.0}, "saturation_concentration"),
        ({"saturation_concentration": 1.0}, "saturation_concentration: 1.0 .* must be below"),
        ({"liquid_diffusivity": 0.0}, "liquid_diffusivity"),
        ({"liquid_diffusivity": float("nan")}, "liquid_diffusivity"),
        ({"interface_diffusivity": -1.0}, "interface_diffusivity"),
        ({"interface_diffusivity": float("nan")}, "interface_diffusivity"),
        ({"interface_diffusivity": None}, "give exactly one"),
        ({"dissolution_flux": 1.0}, "give exactly one"),
        ({"interface_diffusivity": None, "dissolution_flux": -1.0}, "dissolution_flux"),
        ({"interface_diffusivity": None, "dissolution_flux": np.inf}, "dissolution_flux"),
        ({"horizon": 0.05}, "horizon"),
        ({"horizon": float("nan")}, "horizon"),
        ({"influence": "cubic"}, "influence"),
        ({"calibration": "none"}, "calibration"),
        ({"kernel_exponent": 1.0}, "kernel_exponent"),
    ],
)
def test_refusals(options, message):
    with pytest.raises(ValueError, match=message) as caught:
        scene(**options)
    assert "\n" not in str(caught.value)


def test_the_same_input_without_a_mistake_is_accepted():
    accepted = scene(metal_fraction=FRACTION)
    assert accepted.domain.all() and accepted.stencil.bonds == 20


@pytest.mark.parametrize("dimension", [1, 2, 3])
@pytest.mark.parametrize("ratio", [1, 2, 4])
def test_flux_of_a_flat_front_is_the_one_asked_for(dimension, ratio):
    """dissolution_flux through a flat front into clean liquid, from the nodes' loss rates."""
    shape = (4 * ratio,) + (2 * ratio + 1,) * (dimension - 1)
    spacing = 1e-4
    lattice = Lattice((0.0,) * dimension, (spacing,) * dimension, shape)
    metal = np.zeros(shape, bool)
    metal[: 2 * ratio] = True
    flux = 3e-6
    flat = CorrosionScene(
        lattice,
        ratio * spacing,
        metal,
        boundary="no_flux",
        solid_concentration=7e4,
        saturation_concentration=1e3,
        dissolution_flux=flux,
        flux_calibration="axis",
    )
    # a column whose neighbourhood the box does not cut
    column = (slice(None),) + (ratio,) * (dimension - 1)
    rates = BiMaterial(flat).metal_rates()[column]
    assert (rates > 0).sum() == ratio
    # round-off: measured 4e-16
    assert rates.sum() * spacing * 7e4 == pytest.approx(flux, rel=1e-13)


def test_refreshed_layer_is_as_thick_as_the_horizon():
    for ratio in (1, 2, 3):
        box = pin(2, 20, ratio)
        layer = box.refreshed()
        depth = np.minimum(*np.broadcast_arrays(
            *[np.minimum(i, 19 - i) for i in np.ogrid[:20, :20]]
        ))  # fmt: skip
        np.testing.assert_array_equal(layer, depth < ratio)
    assert not pin(2, 20, 2, boundary="no_flux").refreshed().any()


def test_refreshed_layer_follows_a_round_domain_and_spares_the_metal():
    lattice = box_lattice((-1.0,) * 3, (1.0,) * 3, 0.1)
    domain = ball(lattice, (0.0,) * 3, 0.95)
    metal = ball(lattice, (0.0, 0.0, 0.5), 0.3)
    round_scene = CorrosionScene(lattice, 0.2, metal, domain=domain, interface_diffusivity=1e-12)
    layer = round_scene.refreshed()
    radius = np.sqrt(sum(x**2 for x in lattice.coordinates()))
    assert layer.any() and not layer[~domain].any() and not layer[metal].any()
    # within a cell of the edge's staircase
    assert radius[layer].min() > 0.95 - 0.2 - 0.1
    assert np.all(layer[domain & ~metal & (radius > 0.95 - 0.2 + 0.1)])


def test_capacity_keeps_volumes_of_both_phases():
    """Cut cells: the metal's total is sum(metal_fraction) cells, nothing is lost or negative."""
    lattice = box_lattice((-1.0,) * 2, (1.0,) * 2, 0.1)
    x, y = lattice.coordinates()
    radius = np.sqrt(x**2 + y**2)
    fraction = np.clip((0.6 - radius) / 0.1 + 0.5, 0.0, 1.0)
    cut = CorrosionScene(
        lattice,
        0.2,
        fraction > 0.5,
        metal_fraction=fraction,
        interface_diffusivity=1e-12,
    )
    capacity = cut.capacity()
    assert ((fraction > 0) & (fraction < 1)).any()
    # round-off of sums of 400 cells
    assert capacity[cut.metal].sum() == pytest.approx(fraction.sum(), rel=1e-13)
    assert capacity.sum() == pytest.approx(400.0, rel=1e-13)
    assert capacity.min() > 0 and capacity.max() < 2.5
    np.testing.assert_array_equal(scene().capacity(), np.ones((5, 6)))
    assert cut.capacity() is capacity and not capacity.flags.writeable


def test_cut_cells_are_shared_out_the_same_on_a_wider_lattice():
    """Only the box around the cut cells is worked on."""
    inner = (slice(3, 12), slice(7, 15))
    found = []
    for shape, where in (((9, 8), (slice(None),) * 2), ((20, 30), inner)):
        metal, fraction = np.zeros(shape, bool), np.zeros(shape)
        metal[where][2:6, 3:6] = True
        fraction[where][1:7, 2:7] = np.random.default_rng(3).random((6, 5))
        fraction[where][3:5, 4] = 1.0  # no liquid beside them
        whole = scene(
            lattice=Lattice((0, 0), (1e-4,) * 2, shape), metal=metal, metal_fraction=fraction,
            horizon=2e-4,
        )  # fmt: skip
        assert whole.capacity().sum() == pytest.approx(np.prod(shape), rel=1e-13)
        found.append(whole.capacity()[where])
    assert np.ptp(found[0]) > 0.5
    np.testing.assert_allclose(found[1], found[0], rtol=1e-13)  # measured 0

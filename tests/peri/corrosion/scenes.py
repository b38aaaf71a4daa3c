"""Small scenes that the tests of corrosion share."""

import numpy as np
from scipy.integrate import solve_ivp

from peri.corrosion.acidity import AcidityLaw
from peri.corrosion.kinetics import ButlerVolmer, ConstantRate, Exposed, Tafel, VolumeLossLaw
from peri.corrosion.nodes.bimaterial import BiMaterial
from peri.corrosion.passivity import Repassivation, Rupture
from peri.corrosion.scene import CorrosionScene
from peri.engine.lattice import ball, box_lattice

WEEK = 7 * 86400.0

LAWS = {
    "constant": ConstantRate(),
    "volume_loss": VolumeLossLaw(0.1),
    "tafel": Tafel(0.03, 0.1),
    "butler_volmer": ButlerVolmer(0.01),
    "acidity": AcidityLaw(2312.88, reference_current=2e-3),
    "repassivation": Repassivation(300.0, 2312.88, 0.5, 200.0),
    "rupture": Rupture(300.0, 2312.88, 0.5, 200.0, rupture=0.2, rupture_width=0.1),
}
"""One law of the rate of each kind, by its name; a new one gets a row here."""


def pin(dimension=3, cells=10, ratio=2, **options):
    """A ball (disc, bar) of metal of diameter 0.5 mm in a box of 1 mm of liquid."""
    spacing = 1e-3 / cells
    lattice = box_lattice((-0.5e-3,) * dimension, (0.5e-3,) * dimension, spacing)
    settings = {
        "metal": ball(lattice, (0.0,) * dimension, 0.25e-3),
        "solid_concentration": 66082.4,
        "saturation_concentration": 2312.88,  # Table 5.4
        "liquid_diffusivity": 1e-9,
        "interface_diffusivity": 1e-15,
        "kinetics": VolumeLossLaw(0.1),
        **options,
    }
    return CorrosionScene(lattice, ratio * spacing, **settings)


def law_scene(law, bond, **options):
    """A disc under a law of the rate and one of the bonds."""
    settings = {"interface_diffusivity": 1e-14, "liquid_diffusivity": 1e-10, **options}
    return pin(2, 12, kinetics=law, dissolution=bond, **settings)


def clean_liquid_loss(scene, times):
    """V_L where the liquid stays clean: one scalar equation, solved to 1e-12.

    C_i = C_solid exp(-lambda_i s), s' = g(V_L(s)), lambda_i the node's interface bond sum.
    """
    rates = BiMaterial(scene).metal_rates()[scene.metal]
    volume = scene.capacity()[scene.metal]
    solid, saturated = scene.solid_concentration, scene.saturation_concentration

    def loss(s):
        left = volume @ (solid * np.exp(-rates * s) - saturated)
        return 1.0 - left / (volume.sum() * (solid - saturated))

    solution = solve_ivp(
        lambda t, s: [scene.kinetics.rate(Exposed(loss(s[0])))],
        (0.0, times[-1]),
        [0.0],
        method="DOP853",
        t_eval=times,
        rtol=1e-12,
        atol=1e-12 * times[-1],
    )
    return np.array([loss(s) for s in solution.y[0]])

"""Another record of an alloy's hardening than the one in its own file."""

from collections.abc import Sequence
from dataclasses import replace

import perilife_data
from fem.constitutive.hardening import fit_voce
from pipeline.scene.scene import Scene, SceneError


def with_hardening(scene: Scene, names: Sequence[str]) -> Scene:
    """The scene with alloys whose hardening is that of the records named.

    names: of shipped records or paths of TOML files, one per alloy at most.

    Raises SceneError for a record of no alloy of the scene, or a second one of the same alloy;
    ValueError or FileNotFoundError for one that cannot be read.
    """
    chosen: dict[str, str] = {}
    for name in names:
        record = perilife_data.load_hardening(name)
        known = [alloy.name for alloy in scene.alloys]
        if record.alloy not in known:
            raise SceneError(
                f"hardening '{name}' is of {record.alloy}; it must be of {', '.join(known)}"
            )
        if record.alloy in chosen:
            raise SceneError(
                f"hardening is {chosen[record.alloy]} and {name}; an alloy must have one only"
            )
        chosen[record.alloy] = str(name)
        curve = fit_voce(
            record.yield_stress.si,
            record.ultimate_tensile_strength.si,
            record.uniform_strain.si,
        )
        alloy = scene.alloy(record.alloy)
        material = replace(
            alloy.material,
            initial_yield_stress=curve.s0,
            hardening_capacity=curve.Q,
            hardening_rate=curve.b,
        )
        new = replace(alloy, material=material, hardening=str(name))
        scene = replace(scene, alloys=tuple(new if a.name == new.name else a for a in scene.alloys))
    return scene

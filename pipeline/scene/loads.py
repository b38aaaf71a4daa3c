"""What the results of the mechanical test are called and how they are shown, for each load.

The loads themselves are in fem.loading, which is slow to import.
"""

import math
from dataclasses import dataclass

from pipeline.scene.units import parse_in


@dataclass(frozen=True)
class LoadNames:
    """Names and units of one load.

    test, strength: for a reader; deed, done: what is done to the solid, as a noun and as a
    participle; reaction, unit: quantity and SI unit as in the columns `force_N`, `torque_N_m`;
    shown_unit, shown_factor: the unit for a reader and how many of it an SI unit is; strain: column
    with the nominal strain; strain_title, strain_remark: the same for a reader; abscissa,
    abscissa_factor, abscissa_title, abscissa_unit: column of tensile.csv against which a curve is
    drawn, what brings it to the unit of the title, that unit.
    """

    test: str
    strength: str
    deed: str
    done: str
    reaction: str
    unit: str
    shown_unit: str
    shown_factor: float
    strain: str
    strain_title: str
    strain_remark: str
    abscissa: str
    abscissa_factor: float
    abscissa_title: str
    abscissa_unit: str

    @property
    def peak(self) -> str:
        """Column of summary.csv with the peak of the reaction, SI."""
        return f"peak_{self.reaction}_{self.unit}"

    @property
    def strain_at_peak(self) -> str:
        """Column of summary.csv with the nominal strain at the peak."""
        return f"{self.strain}_at_peak"

    def shown(self, reaction: float) -> str:
        """A force [N], torque or moment [N m] for a reader."""
        value = self.shown_factor * reaction
        if value >= 1e6:
            return f"{value:.3g} {self.shown_unit}"
        return f"{value:.0f} {self.shown_unit}" if value >= 10 else f"{value:.2g} {self.shown_unit}"


def _turn(test: str, reaction: str, deed: str, done: str) -> LoadNames:
    return LoadNames(
        test=f"{test} test",
        strength=f"strength in {test}",
        deed=deed,
        done=done,
        reaction=reaction,
        unit="N_m",
        shown_unit="N mm",
        shown_factor=1e3,
        strain="strain",
        strain_title="Nominal strain",
        strain_remark="Nominal strain is that of the surface, angle times radius over the length "
        "between the grips.",
        abscissa="angle",
        abscissa_factor=math.degrees(1.0),
        abscissa_title="Angle (°)",
        abscissa_unit="°",
    )


LOADS: dict[str, LoadNames] = {
    "axial": LoadNames(
        test="tensile test",
        strength="strength",
        deed="a pull",
        done="pulled",
        reaction="force",
        unit="N",
        shown_unit="N",
        shown_factor=1.0,
        strain="elongation",
        strain_title="Elongation",
        strain_remark="Elongation is of the length between the grips.",
        abscissa="elongation",
        abscissa_factor=100.0,
        abscissa_title="Elongation (% of the length between the grips)",
        abscissa_unit="%",
    ),
    "torsion": _turn("torsion", "torque", "a twist", "twisted"),
    "bending": _turn("bending", "moment", "bending", "bent"),
}


def read_reaction(text: str, load: str, field: str) -> float:
    """Read a force such as `300N`, under torsion and bending a torque or moment such as `60Nmm`.

    Returns N or N m.  Raises ValueError with one sentence for another form or unit, and where it is
    not above 0.
    """
    axial = load == "axial"
    units = {"N": 1.0, "kN": 1e3} if axial else {"Nmm": 1e-3, "Nm": 1.0}
    value = parse_in(text, field, units, "300N" if axial else "60Nmm")
    if value <= 0:
        raise ValueError(f"{field} is '{text}'; it must be above 0")
    return value

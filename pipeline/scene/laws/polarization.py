"""The polarization law of the engine for an electrode of the data files."""

from peri.corrosion.polarization import (
    ButlerVolmerCurve,
    PiecewiseTafelCurve,
    PolarizationLaw,
    TabulatedCurve,
    TafelCurve,
)
from perilife_data import Electrode


def polarization_law(electrode: Electrode, as_published: bool = False) -> PolarizationLaw:
    """The law of an electrode, SI; as_published: with the printed slopes, even if it falls."""
    used = electrode.as_published() if as_published else electrode
    if used.curve is not None:
        return TabulatedCurve(used.curve.potentials, used.curve.currents)
    if used.butler_volmer is not None:
        numbers = {k: float(v) for k, v in used.butler_volmer.quantities().items()}
        return ButlerVolmerCurve(**numbers, temperature=used.temperature.si)
    pieces = tuple(
        TafelCurve(p.current_density.si, p.tafel_slope.si, p.standard_potential.si)
        for p in used.pieces.values()
    )
    joints = tuple(p.starts_at.si for p in used.pieces.values() if p.starts_at is not None)
    return PiecewiseTafelCurve(pieces, joints, as_published) if joints else pieces[0]

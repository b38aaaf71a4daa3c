"""The published tensile outcome: statements, verdicts, and the oracle that needs no mesh."""

import math

import numpy as np
import pytest

from pipeline.scene.screw import ScrewParameters
from pipeline.stages.damage_map import net_section
from pipeline.studies import published as study
from pipeline.studies.workshop import Row, Workshop, write_page

# the course of the strength left with cells of 50 um at both end faces, as `study published` prints
FIVE = {"1w": 0.69, "2w": 0.57, "4w": 0.43, "8w": 0.27, "24w": 0.07}
TEN = {"1w": 0.76, "2w": 0.64, "4w": 0.38, "8w": 0.25, "24w": 0.15}


def strains(first: float, later: float) -> dict[str, float]:
    return {"0w": first, **dict.fromkeys(study.WEEKS, later)}


def verdicts(five, ten, ductility=(0.05, 0.02)) -> list[bool | None]:
    course = {study.FAST: five, study.SLOW: ten}
    ductile = {alloy: strains(*ductility) for alloy in course}
    return study.Reading("", course, ductile, {}).verdicts()


def test_each_statement_can_be_shown_and_can_fail():
    assert verdicts(FIVE, TEN) == [True] * 6 + [False]
    assert verdicts(FIVE, TEN, (0.05, 0.06)) == [True] * 5 + [False, True]
    # a quarter apart at first, never ahead, and far too strong in the end
    assert verdicts({t: 0.6 for t in FIVE}, {t: 0.9 for t in TEN})[:5] == [False] * 5
    # always ahead: the order does not reverse
    assert verdicts({t: 0.9 for t in FIVE}, TEN)[1:3] == [True, False]


def test_what_a_reading_did_not_compute_it_does_not_say():
    assert verdicts({"24w": 0.07}, {"24w": 0.15})[:5] == [None, None, None, True, True]
    late = study.Reading("", {study.FAST: {}, study.SLOW: {}}, {}, {})
    assert late.verdicts() == [None] * len(study.STATEMENTS)


@pytest.mark.parametrize(
    ("shown", "word"),
    [
        ([True, True, None], "reproduced"),
        ([False, None], "not reproduced"),
        ([True, False], "not decidable"),
        ([None], "not decidable"),
    ],
)
def test_a_verdict_is_what_all_readings_agree_on(shown, word):
    assert study.verdict(shown) == word


def test_the_intact_screw_is_the_same_for_all_corrosions():
    plan = study.plan_pulls(long=True)
    assert {p.mesh_size for p in plan[study.WHOLE]} == {study.PUBLISHED_EDGE}
    intact = [
        (p.immersion, *p.setting())
        for name, pulls in plan.items()
        for p in pulls
        if p.immersion == "0w" and name not in ("P2", study.WHOLE)
    ]
    assert len(intact) == 6 and len(set(intact)) == 2  # alloys


def test_the_course_of_a_reading_is_over_its_own_intact_screw():
    def row(alloy: str, time: str, force: float) -> Row:
        return Row(
            "P1", "", alloy, time, "P1", 3e-4, 2e-4, 0.005, peak_force=force, strain_at_peak=0.01
        )

    rows = [row(study.FAST, "0w", 400.0), row(study.FAST, "24w", 20.0), row(study.SLOW, "8w", 1.0)]
    rows.append(row(study.FAST, "8w", float("nan")))  # given up
    found = study.reading("P1", rows)
    assert found.course == {study.FAST: {"24w": pytest.approx(0.05)}, study.SLOW: {}}
    assert "| P1 | Mg-5Gd |  |  |  |  | 5.0 |" in "\n".join(study.tables([found], []))


def test_the_weakest_layer_is_known_without_a_mesh(tmp_path):
    """Two blocks of metal, the outermost layer 60 and 30 % dissolved: by 1 - q1 f0."""
    shape = (3, 3, 6)
    metal = np.ones(shape, bool)
    concentration = np.full(shape, 2.0)
    concentration[:, :, 0] = 2.0 * (1 - 0.6)
    concentration[:, :, -1] = 2.0 * (1 - 0.3)
    path = tmp_path / "field.npz"
    np.savez(
        path, spacing=(1e-4,) * 3, metal=metal, capacity=np.ones(shape), solid=2.0,
        concentration=concentration,
    )  # fmt: skip
    assert study.weakest_layers(path) == pytest.approx((1 - 1.5 * 0.6, 1 - 1.5 * 0.3))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("alloy", "left", "inside"), [(study.FAST, 0.0857, 0.0914), (study.SLOW, 0.1546, 0.1639)]
)
def test_the_outermost_layer_of_the_screw_after_24_weeks(tmp_path, alloy, left, inside):
    """By share of metal, and by the nodes well inside alone (quick lattice, Table 5.1)."""
    shop = Workshop(tmp_path)
    shop.corrode(alloy, ["0w", *study.WEEKS], **study.AS_PRINTED)  # the steps end at these times
    path = shop.field("", alloy, "24w")
    bottom, top = study.weakest_layers(path)
    assert top == pytest.approx(left, abs=0.002)
    assert alloy != study.FAST or bottom == pytest.approx(0.1340, abs=0.002)
    with np.load(path) as field:
        solid, metal, capacity = float(field["solid"]), field["metal"], field["capacity"]
        carried = np.where(metal, solid, 0.0), field["concentration"]
        top = np.flatnonzero(metal.any(axis=(0, 1)))[-1]
        both = {}
        for name, weight in (("share", capacity), ("inside", (capacity >= 0.8).astype(float))):
            areas = [net_section(c, metal, weight, field["spacing"], solid)[top] for c in carried]
            both[name] = areas[0], areas[1] / areas[0]
    pin = ScrewParameters()
    half, width = pin.pin_diameter / 2, pin.slot_width / 2
    strip = 2 * (width * math.sqrt(half**2 - width**2) + half**2 * math.asin(width / half))
    assert both["share"][0] == pytest.approx(math.pi * half**2 - strip, rel=3e-3)  # 1.554 mm2
    assert both["inside"][0] == pytest.approx(1.46e-6, rel=1e-6)  # 146 nodes
    assert both["inside"][1] == pytest.approx(inside, abs=0.002)


def test_the_tables_are_written_with_the_command_that_made_them(tmp_path):
    path = tmp_path / "new" / study.FILE
    assert write_page(study.TITLE, ["| a | b |"], path, "perilife study x") == path
    lines = path.read_text().splitlines()
    assert lines[0] == f"# {study.TITLE}" and "Written by `perilife study x`." in lines
    assert lines[-1] == "| a | b |" and [p.name for p in path.parent.iterdir()] == [study.FILE]

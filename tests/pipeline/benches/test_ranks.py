"""Marches on ranks as the benchmark times them: the same loss, memory that is shared out."""

import pytest

from pipeline.benches.registry import BENCHMARKS
from tests.ranks import needs_mpirun


@needs_mpirun
@pytest.mark.slow
def test_each_march_is_measured_in_one_process_and_on_ranks():
    found = {r.quantity: r.value for r in BENCHMARKS["ranks"].small()}
    for model in ("bi-material", "ions", "couple"):
        mine = {name: value for name, value in found.items() if name.startswith(model)}
        off = [value for name, value in mine.items() if "beside one process" in name]
        assert len(off) == 2 and max(off) < 1e-8
        processor = [value for name, value in mine.items() if "processor time" in name]
        assert len(processor) == 3 and min(processor) > 0
    metal = {name: value for name, value in found.items() if "bi-material" in name}
    memory = {name: value for name, value in metal.items() if "memory" in name}
    one, two, other = (value for name, value in memory.items() if "one process" not in name)
    assert 0 < other < 0.8 * one and 0 < two < 0.8 * one

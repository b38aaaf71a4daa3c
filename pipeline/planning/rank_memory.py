"""Memory of a march on MPI ranks, as `perilife bench ranks` measures it (peri/MEASURED.md)."""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.scene.units import format_bytes

MARGIN = 1.5
"""What a rank holds over its share of one process: PETSc's arrays, and a horizon of its neighbours'
nodes around its own.  Measured at two ranks: 1.5 (metal), 1.36 (ions), 0.9 (couples)."""
WHOLE_BYTES_PER_NODE = 100.0
"""What the first rank holds beside that: the scene, outputs, fields that are dealt out.  Measured:
22 (metal), 37 (ions), 224 (couples, whose patches are the first rank's)."""
NOT_MEASURED = "the time on ranks is not measured; that of one process is a guide"


@dataclass(frozen=True)
class RankMemory:
    """Bytes of the first of so many ranks and of each other one."""

    ranks: int
    first: float
    other: float

    @property
    def all(self) -> float:
        """Bytes of all ranks together."""
        return self.first + (self.ranks - 1) * self.other

    def in_words(self) -> str:
        """For a reader; empty for one rank."""
        if self.ranks == 1:
            return ""
        return (
            f"{self.ranks} ranks: {format_bytes(self.first)} the first, "
            f"{format_bytes(self.other)} each other; {NOT_MEASURED}"
        )


def rank_memory(nodes: float, march: float, process: float, ranks: int) -> RankMemory:
    """Memory of a march of so many nodes that takes `march` bytes in one process.

    process : bytes of an idle process with the libraries loaded.
    """
    if ranks == 1:
        return RankMemory(1, process + march, 0.0)
    other = process + MARGIN * march / ranks
    return RankMemory(ranks, other + WHOLE_BYTES_PER_NODE * nodes, other)

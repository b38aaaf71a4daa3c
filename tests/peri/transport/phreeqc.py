"""PHREEQC as an independent program: runs inputs, writes a database of our declaration."""

from phreeqpython import PhreeqPython

from peri.transport.chemistry.species import LN10, Chemistry

# The element that PHREEQC books a component under, and its name for the component.
ELEMENT = {
    "CO3": "C", "PO4": "P", "SO4": "S", "Tris": "Tris",
    "Mg": "Mg", "Ca": "Ca", "Na": "Na", "K": "K", "Cl": "Cl",
}  # fmt: skip


def ion(name: str, charge: float) -> str:
    """A species as PHREEQC writes it: Mg+2, CO3-2, CO2."""
    return name + (f"{int(charge):+d}".replace("+1", "+").replace("-1", "-") if charge else "")


def database(chemistry: Chemistry, activity: str = "davies") -> str:
    """A PHREEQC database of exactly this chemistry; without -gamma it uses Davies' equation.

    The diffusivities are those of 25 degC: PHREEQC multiplies them at other temperatures.
    """

    def own(k: int) -> list[str]:
        size, slope = 1e10 * chemistry.ion_size[k], chemistry.strength_coefficient[k]
        gamma = activity == "wateq" and size == size
        diffusing = f"-dw {chemistry.diffusivity[k]:.15g}"
        return [f"-gamma {size:.15g} {slope:.15g}", diffusing] if gamma else [diffusing]

    ions = [ion(n, z) for n, z in zip(chemistry.names, chemistry.charge, strict=True)]
    lines = [
        "SOLUTION_MASTER_SPECIES",
        "H H+ -1 H 1.008", "H(0) H2 0 H", "H(1) H+ -1 0", "E e- 0 0 0",
        "O H2O 0 O 16", "O(0) O2 0 O", "O(-2) H2O 0 0",
    ]  # fmt: skip
    lines += [
        f"{ELEMENT[c]} {i} 0 {ELEMENT[c]} 20"
        for c, i in zip(chemistry.components, ions, strict=False)
        if c != "H"
    ]
    lines += [
        "SOLUTION_SPECIES",
        "H+ = H+",
        "log_k 0",
        *own(chemistry.components.index("H")),
        "e- = e-",
        "log_k 0",
        "H2O = H2O",
        "log_k 0",
    ]
    lines += ["2 H2O = O2 + 4 H+ + 4 e-", "log_k -86", "2 H+ + 2 e- = H2", "log_k -3.1"]
    for k, name in enumerate(ions):
        if k < len(chemistry.components):
            lines += [f"{name} = {name}", "log_k 0", *own(k)] if name != "H+" else []
            continue
        row = chemistry.stoichiometry[k]
        sides = _sides(row, ions, chemistry.water[k], name)
        lines += [sides, f"log_k {chemistry.ln_k[k] / LN10:.15g}", *own(k)]
    lines.append("PHASES")
    for mineral in chemistry.minerals:
        formula = {
            "brucite": "Mg(OH)2", "calcite": "CaCO3", "magnesite": "MgCO3",
            "hydroxyapatite": "Ca5(PO4)3OH",
        }[mineral.name]  # fmt: skip
        left, right = [formula], []
        for c, count in zip(ions, mineral.stoichiometry, strict=False):
            (right if count > 0 else left).extend([f"{abs(count):g} {c}"] if count else [])
        if mineral.water:
            right.append(f"{mineral.water} H2O")
        lines += [mineral.name, " + ".join(left) + " = " + " + ".join(right)]
        lines.append(f"log_k {mineral.ln_k / LN10:.15g}")
    return "\n".join([*lines, "END", ""])


def _sides(row, ions, water, name) -> str:
    left = [f"{n:g} {c}" for c, n in zip(ions, row, strict=False) if n > 0]
    right = [name] + [f"{-n:g} {c}" for c, n in zip(ions, row, strict=False) if n < 0]
    if water:
        (left if water > 0 else right).append(f"{abs(water):g} H2O")
    return " + ".join(left) + " = " + " + ".join(right)


def run(text: str, own_database: str | None = None) -> list[dict[str, float]]:
    """Run an input with phreeqc.dat or a database of one's own; rows of its selected output."""
    program = PhreeqPython(database="phreeqc.dat").ip
    if own_database is not None:
        program.load_database_string(own_database)
    program.run_string(text)
    head, *rows = program.get_selected_output_array()
    return [dict(zip(head, row, strict=True)) for row in rows]


def solution(totals: dict[str, float], celsius: float, with_carbon: str = "C") -> str:
    """A SOLUTION block of totals in mol/m3, pH from the charge balance."""
    names = {"HCO3": with_carbon, "HPO4": "P", "SO4": "S"}
    lines = [f"SOLUTION 1\n temp {celsius}\n units mol/kgw\n pH 7.4 charge"]
    lines += [f" {names.get(n, n)} {v * 1e-3:.15g}" for n, v in totals.items() if v > 0]
    return "\n".join(lines) + "\n"


def punch(chemistry: Chemistry, more: str = "", values: str = "") -> str:
    """A block that prints pH, ionic strength, DH_A, DH_B, and the index of every mineral."""
    names = [m.name for m in chemistry.minerals]
    index = "".join(f', SI("{n}")' for n in names)
    return (
        "KNOBS\n -convergence_tolerance 1e-12\nSELECTED_OUTPUT\n -reset false\n"
        " -high_precision true\nUSER_PUNCH\n -headings pH mu A B "
        + " ".join(names)
        + more
        + f'\n 10 PUNCH -LA("H+"), MU, DH_A, DH_B{index}{values}\n'
    )


def dissolution(
    chemistry: Chemistry, totals: dict[str, float], flux: float, length: float, cells: int
) -> list[dict[str, float]]:
    """Mg(OH)2 set free at the closed end of a column of liquid that ends in the medium, 25 degC.

    TRANSPORT -multi_d, 3000 s (the column comes to rest in about 300): pH, Mg (mol/m3) and CHARGE
    (mol/m3) of every cell, from the closed end; the last centre is half a cell from the medium.
    flux : mol/m2/s;  length : from the first cell's centre to the medium, m
    """
    size = length / (cells - 0.5)
    medium = solution(totals, 25).replace("SOLUTION 1", f"SOLUTION 0-{cells + 1}")
    text = (
        medium
        + f"""
RATES
 metal
 -start
 10 SAVE {flux * 1e-3 / size:.15g} * TIME
 -end
KINETICS 1
 metal
 -formula Mg 1 O 2 H 2
 -m0 1e6
 -tol 1e-10
END
SELECTED_OUTPUT
 -reset false
 -high_precision true
USER_PUNCH
 -headings pH Mg charge
 10 PUNCH -LA("H+"), 1e3 * TOT("Mg"), 1e3 * CHARGE_BALANCE
TRANSPORT
 -cells {cells}
 -shifts 300
 -time_step 10
 -flow_direction diffusion_only
 -boundary_conditions closed constant
 -lengths {size:.15g}
 -multi_d true 1e-9 1.0 0.0 1.0
 -punch_cells 1-{cells}
 -punch_frequency 300
"""
    )
    return run(text, database(chemistry))[-cells:]

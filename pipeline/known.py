"""The command `perilife alloys`: alloys, parameter sets and other records that are shipped."""

from dataclasses import asdict

import perilife_data


def known() -> dict[str, dict[str, dict]]:
    """Everything that is shipped by kind and name, each quantity with unit, source and kind."""
    alloys = {name: perilife_data.load_alloy(name) for name in perilife_data.list_alloys()}
    sets = {n: perilife_data.load_parameter_set(n) for n in perilife_data.list_parameter_sets()}
    records = {name: perilife_data.load_hardening(name) for name in perilife_data.list_hardening()}
    losses = {n: perilife_data.load_experiment(n) for n in perilife_data.list_experiments()}
    return {
        "alloys": {
            name: {
                "title": alloy.title,
                "corrodes": _corrodes(alloy),
                "quantities": _plain(alloy.quantities()),
            }
            for name, alloy in alloys.items()
        },
        "parameter_sets": {
            name: {
                "title": found.title,
                "alloys": {a: _plain(found.for_alloy(a).quantities()) for a in found.alloys},
            }
            for name, found in sets.items()
        },
        "hardening": {
            name: {
                "title": record.title,
                "alloy": record.alloy,
                "quantities": _plain(record.quantities()),
            }
            for name, record in records.items()
        },
        "experiments": {
            name: {
                "title": experiment.title,
                "results": {label: asdict(loss) for label, loss in experiment.results.items()},
            }
            for name, experiment in losses.items()
        },
    }


def _plain(quantities: dict[str, perilife_data.Quantity]) -> dict[str, dict]:
    return {name: asdict(quantity) for name, quantity in quantities.items()}


def _corrodes(alloy: perilife_data.Alloy) -> bool:
    """Whether its own file or a shipped set has constants of it; else it can be pulled only."""
    names = perilife_data.list_parameter_sets()
    return alloy.corrosion is not None or any(
        alloy.name in perilife_data.load_parameter_set(name).alloys for name in names
    )


def print_known() -> None:
    """Print names and titles for a reader."""
    for name in perilife_data.list_alloys():
        alloy = perilife_data.load_alloy(name)
        only = "" if _corrodes(alloy) else " (no corrosion constants: pulled only)"
        print(f"{name:12s} {alloy.title}{only}")
    print()
    for name in perilife_data.list_parameter_sets():
        parameters = perilife_data.load_parameter_set(name)
        print(f"{name:24s} {parameters.title} ({', '.join(parameters.alloys)})")
    print("\nother records of hardening (--hardening)")
    for name in perilife_data.list_hardening():
        print(f"{name:26s} {perilife_data.load_hardening(name).title}")
    print("\nlosses that others printed (perilife_data.load_experiment)")
    for name in perilife_data.list_experiments():
        experiment = perilife_data.load_experiment(name)
        for label, loss in experiment.results.items():
            found = [str(q) for q in (loss.degradation_rate, loss.mass_loss) if q is not None]
            after = "" if loss.after is None else f" after {loss.after}"
            print(f"{name:16s} {label.replace('_', ' ')}: {found[0]}{after} ({experiment.title})")

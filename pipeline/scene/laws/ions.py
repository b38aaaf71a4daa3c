"""The ions of the medium as numbers of the scene: what `--model nnpp` adds to it."""

import math
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import perilife_data
from pipeline.scene.laws.electrodes import ElectrodeSettings
from pipeline.scene.laws.feedback import FeedbackSettings

MODELS = ("bi-material", "nnpp")
DEFAULT_MEDIUM = "simulated-body-fluid"
DEFAULT_MINERALS = ("brucite", "calcite", "hydroxyapatite")
ACTIVITIES = ("fixed", "wateq", "ideal")
FLUX_FORMS = ("sqra", "sg", "mean", "as_published")
CLOSURES = ("electroneutral", "poisson", "as_published", "none")
"""As in peri.transport, which is slow to import."""


@dataclass(frozen=True)
class IonSettings:
    """The medium, its chemistry as numbers (SI, log10 K in mol/L), and how it is solved.

    totals : amount of each species that the medium is made of, mol/m^3.
    chemistry : the reaction set at the medium's temperature (perilife_data ReactionNumbers as a
    plain mapping; the rate constant of a mineral in equilibrium is None).
    bath_volume : m^3 of the bath around the liquid, None: so much that it does not change;
    exchange_every : s between exchanges of the bath for fresh medium, None: never;
    open_to : dissolved gases whose activity in the bath stays that of the fresh medium;
    feedback : what the liquid does to the metal's rate, None: nothing;
    electrodes : anode and cathode in the place of the law of the rate, None: that law.
    assumed : names of the set's and the medium's quantities that are assumed or fitted.
    """

    medium: str
    title: str
    reactions: str
    totals: dict[str, float]
    chemistry: dict[str, object]
    activity: str = "fixed"
    flux_form: str = "sqra"
    closure: str = "electroneutral"
    bath_volume: float | None = None
    exchange_every: float | None = None
    open_to: tuple[str, ...] = ()
    feedback: FeedbackSettings | None = None
    electrodes: ElectrodeSettings | None = None
    assumed: tuple[str, ...] = ()
    source: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, value, allowed in (
            ("activity", self.activity, ACTIVITIES),
            ("flux form", self.flux_form, FLUX_FORMS),
            ("closure", self.closure, CLOSURES),
        ):
            if value not in allowed:
                raise ValueError(f"{name} is '{value}'; it must be one of {', '.join(allowed)}")

        beside = {"exchange every": self.exchange_every, "open to": self.open_to or None}
        for name, value in beside.items():
            if value is not None and self.bath_volume is None:
                raise ValueError(
                    f"{name} goes with a bath of finite volume, which must be given too "
                    "(--bath-volume)"
                )
        for name in self.open_to:
            charges: dict[str, int] = self.chemistry["charge_number"]  # type: ignore[assignment]
            neutral = [n for n, z in charges.items() if z == 0]
            if name not in neutral:
                raise ValueError(
                    f"open to is '{name}'; it must be a dissolved gas, one of "
                    f"{', '.join(neutral) or 'none in this set'}"
                )
        minerals: dict[str, dict] = self.chemistry["minerals"]  # type: ignore[assignment]
        published = "as_published" in (self.flux_form, self.closure)
        for name, mineral in minerals.items():
            if published and mineral["kind"] == "equilibrium":
                raise ValueError(
                    f"flux form and closure as_published know no mineral in equilibrium, such as "
                    f"{name}; --minerals without it leaves it out"
                )
        self._check_electrodes()

    def _check_electrodes(self) -> None:
        """Refuse what does not go with the electrodes, and an inhibitor that the set has not."""
        if (
            self.feedback is not None
            and self.feedback.inhibitor
            and (self.chemistry.get("inhibitor") is None)
        ):
            raise ValueError(
                f"feedback: inhibitor is yes, but the reaction set '{self.reactions}' has none"
            )
        if self.electrodes is None:
            return
        balance = self.electrodes.balance
        if (
            self.feedback is not None
            and self.feedback.in_words() != "the inhibitor of the reaction set"
        ):
            raise ValueError(
                "electrodes are a law of the rate of their own, which factors of the feedback do "
                "not multiply; leave one of them out"
            )
        if balance != "local" and self.closure not in ("electroneutral", "poisson"):
            raise ValueError(
                f"closure is '{self.closure}' with electrodes of balance {balance}, whose current "
                "needs a potential; it must be electroneutral or poisson"
            )
        if balance == "applied" and self.bath_volume is not None:
            raise ValueError(
                "electrodes of balance applied go without a bath of finite volume, which the "
                "counter electrode would change"
            )

    @property
    def temperature(self) -> float:
        """K."""
        return float(self.chemistry["temperature"])  # type: ignore[arg-type]

    @property
    def minerals(self) -> tuple[str, ...]:
        """Names of the minerals that may form."""
        return tuple(self.chemistry["minerals"])  # type: ignore[arg-type]


def resolve_ions(
    medium: str = DEFAULT_MEDIUM,
    minerals: list[str] | None = None,
    balance: str | None = None,
    bath_volume: float | None = None,
    exchange_every: float | None = None,
    **options: str | tuple[str, ...] | FeedbackSettings | ElectrodeSettings,
) -> IonSettings:
    """Read a medium and its reaction set.

    medium : name of a shipped medium, or path of a TOML file; minerals : names, None for the
    default ones that the set holds; balance : a species whose amount is what neutrality wants
    (the medium's charge is otherwise made up by H); bath_volume, exchange_every : m^3 and s
    (default: those of the medium's file); options : activity, flux_form, closure, open_to,
    feedback, electrodes.

    Raises ValueError or FileNotFoundError with one sentence for whatever cannot be computed.
    """
    loaded = perilife_data.load_medium(medium)
    if not loaded.reactions:
        known = [n for n in perilife_data.list_media() if perilife_data.load_medium(n).reactions]
        raise ValueError(
            f"medium is '{loaded.name}', whose ions are not listed; those with ions are "
            f"{', '.join(known)}"
        )
    reactions = perilife_data.load_reaction_set(loaded.reactions)
    if minerals is None:
        minerals = [m for m in DEFAULT_MINERALS if m in reactions.minerals]
    numbers = reactions.at(loaded.temperature.si, tuple(minerals))
    totals = {}
    for name, species in loaded.species.items():
        if name not in reactions.species:
            raise ValueError(
                f"medium '{loaded.name}' holds {name}, which the reaction set "
                f"'{reactions.name}' does not know; it knows {', '.join(reactions.species)}"
            )
        if name not in ("H", "OH"):  # their amounts follow from neutrality
            totals[name] = species.total_concentration.si
    if balance is not None:
        totals = _balanced(totals, numbers.charge_number, balance)
    chemistry = asdict(numbers)
    for mineral in chemistry["minerals"].values():
        if math.isinf(mineral["rate_constant"]):
            mineral["rate_constant"] = None
    if chemistry["inhibitor"] is None:
        del chemistry["inhibitor"]
    used = set(minerals)
    assumed = [
        f"{reactions.name}: {n}"
        for n in reactions.assumed()
        if not n.startswith("minerals.") or n.split(".")[1] in used
    ]
    assumed += [f"{loaded.name}: {n}" for n in loaded.assumed()]
    exchange = exchange_every
    if exchange is None and loaded.refresh_interval and _or(bath_volume, loaded.bath_volume):
        exchange = loaded.refresh_interval.si
    settings = IonSettings(
        medium=loaded.name,
        title=loaded.title,
        reactions=reactions.name,
        totals=totals,
        chemistry=_plain(chemistry),
        activity=reactions.activity if reactions.activity != "davies" else "fixed",
        bath_volume=_or(bath_volume, loaded.bath_volume),
        exchange_every=exchange,
        assumed=tuple(assumed),
        source={"medium": str(Path(medium))},
    )
    return replace(settings, **options)


def _or(given: float | None, listed: perilife_data.Quantity | None) -> float | None:
    """What was given, else what the medium's file lists."""
    return given if given is not None or listed is None else listed.si


def _balanced(totals: dict[str, float], charges: dict[str, int], balance: str) -> dict[str, float]:
    """The totals read as ions, with as much of one species as makes them neutral."""
    if not charges.get(balance):
        ions = ", ".join(n for n, z in charges.items() if z)
        raise ValueError(f"balance is '{balance}'; it must be an ion of the set, one of {ions}")
    rest = sum(charges[n] * c for n, c in totals.items() if n != balance)
    amount = -rest / charges[balance]
    if amount < 0:
        raise ValueError(
            f"balance is '{balance}'; the other ions carry {rest:+.4g} mol/m^3 of charge, which "
            "it cannot make up for"
        )
    return {**totals, balance: amount}


def _plain(value: object) -> object:
    """Tuples as lists, so that a scene read back from JSON is equal."""
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value

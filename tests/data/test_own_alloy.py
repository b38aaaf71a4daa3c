"""The file of an alloy of one's own: filled in from the template, with constants and without."""

import re
import shlex
import subprocess
from pathlib import Path

import pytest

import perilife_data
from perilife_data.own_files import FILL_IN
from perilife_data.template import alloy_like, alloy_template

VALUES = {
    "mass_fractions.Zn": 1,
    "charge_number": 2,
    "young_modulus": 44,
    "poisson_ratio": 0.3,
    "yield_stress": 200,
    "ultimate_tensile_strength": 260,
    "uniform_strain": 0.1,
    "q1": 1.5,
    "corrosion.scene.nodes": 34153,
    "corrosion.scene.spacing": 100,
    "corrosion.scene.horizon_ratio": 2,
    "corrosion.scene.diameter": 3,
    "corrosion.scene.height": 4.8,
    "corrosion.interface_diffusivity": 3e-15,
    "corrosion.liquid_diffusivity": 9e-9,
    "corrosion.saturation_concentration": 0.7,
    "corrosion.volume_loss_scale": 0.2,
    "corrosion.kernel_exponent": 0,
}


def filled_in(text: str, corrosion: bool = False) -> str:
    """The template with a number in every table, a title and a source."""
    if corrosion:  # tables and keys, not the sentences
        text = re.sub(r'(?m)^# (\[|\w+ = ["\w])', r"\1", text)
    for table, value in VALUES.items():
        pattern = rf"(?m)^(\[{re.escape(table)}\]\nvalue = ).*$"
        text = re.sub(pattern, rf"\g<1>{value!r}", text)
    text = text.replace(f'source = "{FILL_IN}"', 'source = "hermann2024"')
    text = text.replace(f'kind = "{FILL_IN}"', 'kind = "published"')
    return re.sub(rf'(?m)^(\w+ = )"{FILL_IN}"', r'\1"here"', text)


def written(folder: Path, text: str) -> Path:
    path = folder / "own.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_template_filled_in_is_an_alloy(tmp_path: Path) -> None:
    alloy = perilife_data.load_alloy(written(tmp_path, filled_in(alloy_template("ZX10"))))
    assert (alloy.name, alloy.young_modulus.si, alloy.corrosion) == ("ZX10", 44e9, None)
    assert list(alloy.mass_fractions) == ["Mg", "Zn"]
    text = filled_in(alloy_template("ZX10"), corrosion=True)
    assert FILL_IN not in "".join(line for line in text.splitlines() if line[:1] != "#")
    with_corrosion = perilife_data.load_alloy(written(tmp_path, text))
    own = with_corrosion.corrosion
    assert own.parameters.interface_diffusivity.si == 3e-15
    assert own.scene.horizon_ratio.si == 2 and own.medium == "cell-culture-medium"
    # C_solid is that of the composition where the file has none of its own
    assert own.parameters.solid_concentration == alloy.solid_concentration
    assert set(VALUES) - {"mass_fractions.Zn"} <= {
        name.replace("corrosion.parameters.", "corrosion.") for name in with_corrosion.quantities()
    }


def test_the_file_says_with_what_a_fit_may_begin(tmp_path: Path) -> None:
    text = filled_in(alloy_template("ZX10"))
    command = re.search(r"(?m)^#     (sed -i .*) THIS-FILE.toml$", text)
    path = written(tmp_path, text)
    subprocess.run([*shlex.split(command[1]), str(path)], check=True)
    own = perilife_data.load_alloy(path).corrosion
    begun = perilife_data.load_parameter_set("table-5.1")
    assert own.parameters.interface_diffusivity.si == 2.8779e-15
    assert own.scene.diameter.si == begun.scene.diameter.si
    kinds = {name: q.kind for name, q in own.quantities().items()}
    assert kinds.pop("parameters.solid_concentration") == "derived"
    assert set(kinds.values()) == {"assumed"}


def test_the_source_that_the_file_shows_can_be_read(tmp_path: Path) -> None:
    text = filled_in(alloy_template("ZX10")).replace("hermann2024", "our-report-12")
    entry = re.search(r"(?ms)^# +(@misc.*?\n)# +}$", text)
    (tmp_path / "references.bib").write_text(re.sub(r"(?m)^# +", "", entry[1]) + "}\n")
    path = written(tmp_path, text)
    assert perilife_data.load_alloy(path).young_modulus.source == "our-report-12"


@pytest.mark.parametrize("key", ["title", "young_modulus", "q1"])
def test_what_is_still_to_be_filled_in_is_named(key: str, tmp_path: Path) -> None:
    text = filled_in(alloy_template("ZX10"))
    line = 'title = "here"' if key == "title" else f"[{key}]\nvalue = {VALUES[key]!r}"
    assert line in text
    left = text.replace(
        line, line.replace("here", FILL_IN).replace(repr(VALUES.get(key)), f'"{FILL_IN}"')
    )
    with pytest.raises(ValueError, match=f"own.toml: {key}.* is '{FILL_IN}'; it "):
        perilife_data.load_alloy(written(tmp_path, left))


def test_everything_that_is_still_to_be_filled_in_is_named_at_once(tmp_path: Path) -> None:
    text = re.sub(r"(\[q1\]\nvalue = ).*", r"\g<1>1.5", alloy_template("ZX10"))
    path = written(tmp_path, text)
    with pytest.raises(ValueError, match="they are still to be filled in") as refusal:
        perilife_data.load_alloy(path)
    named = str(refusal.value).split(": ")[1].split(" are ")[0].split(", ")
    quantities = [key for key in VALUES if not key.startswith("corrosion") and key != "q1"]
    assert named == ["title", *quantities, "q1.source", "q1.where", "q1.kind"]


def test_a_name_without_the_ending_of_its_file_is_understood_as_such(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    written(tmp_path, filled_in(alloy_template("ZX10")))
    with pytest.raises(ValueError, match=r"'own' is unknown \(did you mean own.toml\?\)"):
        perilife_data.load_alloy("own")


def test_half_of_the_constants_is_refused(tmp_path: Path) -> None:
    text = filled_in(alloy_template("ZX10"), corrosion=True)
    less = re.sub(r"\[corrosion.volume_loss_scale\][^[]*", "", text)
    with pytest.raises(ValueError, match="corrosion.volume_loss_scale is missing"):
        perilife_data.load_alloy(written(tmp_path, less))
    more = text.replace("value = 0.7\n", "value = 8e4\n")
    with pytest.raises(ValueError, match="saturation_concentration is 80000 .* below the solid_c"):
        perilife_data.load_alloy(written(tmp_path, more))
    other = text.replace('medium = "cell-culture-medium"', 'medium = "tea"')
    with pytest.raises(ValueError, match="corrosion.medium is 'tea'; it must be one of"):
        perilife_data.load_alloy(written(tmp_path, other))


def test_a_shipped_name_with_other_numbers_is_refused(tmp_path: Path) -> None:
    text = Path(perilife_data.__path__[0], "alloys", "mg-5gd.toml").read_text(encoding="utf-8")
    same = written(tmp_path, text.replace("Magnesium with", "Mg with"))  # words are no numbers
    assert perilife_data.load_alloy(same).young_modulus.si == 43e9
    for old, new, words in (
        ("value = 43\n", "value = 45\n", "young_modulus is 43 GPa, not 45 GPa"),
        ('name = "Mg-5Gd"', 'name = "WE43"', "a shipped alloy whose"),
        ('name = "Mg-5Gd"', 'name = "MG-10gd"', "mass_fractions.Mg is 0.9, not 0.95"),
    ):
        assert old in text
        path = written(tmp_path, text.replace(old, new))
        with pytest.raises(ValueError, match=words) as refusal:
            perilife_data.load_alloy(path)
        assert str(refusal.value).endswith("give the alloy another name")
    renamed = written(tmp_path, text.replace('name = "Mg-5Gd"', 'name = "mine"'))
    assert perilife_data.load_alloy(renamed).name == "mine"
    constants = filled_in(alloy_template("ZX10"), corrosion=True)
    added = text + constants[constants.index("[corrosion]") :]
    with pytest.raises(ValueError, match="corrosion.* is not given, not"):
        perilife_data.load_alloy(written(tmp_path, added))


def test_a_shipped_alloy_may_be_the_beginning(tmp_path: Path) -> None:
    path = written(tmp_path, alloy_like("my-WE43", "WE43"))
    own, shipped = perilife_data.load_alloy(path), perilife_data.load_alloy("WE43")
    assert own.name == "my-WE43" and own.quantities() == shipped.quantities()
    with pytest.raises(ValueError, match="alloy 'WE34' is unknown .did you mean WE43"):
        alloy_like("mine", "WE34")


@pytest.mark.parametrize(
    ("name", "words"),
    [("we43", "which is shipped.*--like WE43"), ("a/b", "must begin with"), (".x", "must begin")],
)
def test_names_that_cannot_be_are_refused(name: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        alloy_template(name)

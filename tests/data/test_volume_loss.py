"""Reading a person's own volume-loss CSV: what is accepted and every refusal."""

from pathlib import Path

import numpy as np
import pytest

from perilife_data import read_volume_loss_csv

HEADER = "immersion time [w], volume loss [%], standard deviation [%]\n"


def write(folder: Path, text: str | bytes) -> Path:
    path = folder / "own.csv"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def test_units_are_converted(tmp_path: Path) -> None:
    data = read_volume_loss_csv(write(tmp_path, "# own data\n\n" + HEADER + "1,3.1,0.4\n8,14,1\n"))
    np.testing.assert_array_equal(data.times, [604800.0, 4838400.0])
    # One product with 0.01: equal up to one rounding.
    np.testing.assert_allclose(data.volume_loss, [0.031, 0.14], rtol=3e-16)
    np.testing.assert_allclose(data.standard_deviation, [0.004, 0.01], rtol=3e-16)


@pytest.mark.parametrize(
    "text",
    [
        "volume loss [1],immersion time [d]\n0.031,7\n",
        "Volume Loss [ 1 ] ; Immersion  Time [d]\r\n0.031 ; 7\r\n",
        "\ufeffimmersion time [h],volume loss [1]\n168,0.031",
    ],
    ids=["other order", "semicolons and blanks", "byte-order mark"],
)
def test_other_ways_to_write_the_same(text: str, tmp_path: Path) -> None:
    data = read_volume_loss_csv(write(tmp_path, text))
    assert (data.times.tolist(), data.volume_loss.tolist()) == ([604800.0], [0.031])
    assert data.standard_deviation is None


def test_a_time_may_occur_more_than_once(tmp_path: Path) -> None:
    data = read_volume_loss_csv(write(tmp_path, HEADER + "0,0,0\n1,3,0\n1,4,0\n"))
    assert data.times.tolist() == [0.0, 604800.0, 604800.0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has no measurements"),
        (HEADER, "has no measurements"),
        ("immersion time [d]\n1\n", r"column 'volume loss \[unit\]' is missing"),
        ("volume loss [1]\n1\n", r"column 'immersion time \[unit\]' is missing"),
        ("immersion time,volume loss [1]\n1,0\n", "column 'immersion time' has no unit; write"),
        ("immersion time [a],volume loss [1]\n1,0\n", "has the unit 'a'; write .* s, min, h, d"),
        ("immersion time [mm],volume loss [1]\n1,0\n", "has the unit 'mm'"),
        ("immersion time [d],mass loss [1]\n1,0\n", r"column 'mass loss \[1\]' is unknown"),
        (
            "immersion time [d],volume loss [1],volume loss [%]\n1,0,0\n",
            "column 'volume loss' is given twice",
        ),
        (HEADER + "1,2\n", "line 2: has 2 cells; the header names 3 columns"),
        (HEADER + "1,3,1,0,4\n", "line 2: has 5 cells; .*decimals are written with a point"),
        (HEADER + "1,much,0\n", "line 2: volume loss is 'much'; it must be a finite number"),
        (HEADER + "1,nan,0\n", "line 2: volume loss is 'nan'"),
        (HEADER + "inf,1,0\n", "line 2: immersion time is 'inf'"),
        (HEADER + "-1,1,0\n", "line 2: immersion time is -1; it must be at least 0"),
        (HEADER + "2,1,0\n\n1,1,0\n", "line 4: immersion time is 1, below the row before"),
        (HEADER + "1,101,0\n", "line 2: volume loss is 101 %; it must be between 0 and 100 %"),
        (HEADER + "1,-1,0\n", "line 2: volume loss is -1 %; it must be between 0 and 100 %"),
        (HEADER + "1,1,-1\n", "line 2: standard deviation is -1 %"),
        (
            "immersion time [d],volume loss [1]\n1,3.1\n",
            r"volume loss is 3.1; it must be between 0 and 1, or given in \[%\]",
        ),
        (b"\xff\xfe\x00", "is not a text file in UTF-8"),
    ],
)
def test_refusals(text: str | bytes, message: str, tmp_path: Path) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ValueError, match=message) as refusal:
        read_volume_loss_csv(path)
    assert "\n" not in str(refusal.value)
    assert str(refusal.value).startswith(str(path))


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="none.csv: there is no such file"):
        read_volume_loss_csv(tmp_path / "none.csv")

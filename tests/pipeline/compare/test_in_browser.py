"""The comparison in a real browser, Debian's chromium without a screen.

apt-get install --no-install-recommends chromium
pytest -m slow tests/pipeline/compare/test_in_browser.py
"""

import shutil

import pytest

from pipeline.cli import main
from tests.pipeline.report.browser import MISSING, Browser
from tests.pipeline.report.run_folders import pin_mesh, scene_of, write_run

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    if shutil.which("chromium") is None:
        pytest.fail(MISSING, pytrace=False)
    place = tmp_path_factory.mktemp("browser")
    for name, changes in {
        "first": {"hold": ["all"]},
        "a-run-with-a-name-longer-than-most-of-them": {"resolution_name": "fine"},
        "twisted": {"tensile": {"load": "torsion"}},
    }.items():
        write_run(place / name, scene_of(**changes), *pin_mesh(1e-3))
    runs = [str(path) for path in place.iterdir()]
    assert main(["compare", *runs, "--out", str(place / "page.html")]) == 0
    return place / "page.html"


@pytest.mark.parametrize("width, dark", [(1100, False), (390, False), (390, True)])
def test_nothing_is_cut_asked_for_or_complained_of(page, tmp_path, width, dark):
    with Browser(tmp_path) as browser:
        browser.show(page, width, 900, dark)
        assert browser.value("document.documentElement.scrollWidth") == width
        beyond = browser.value(
            "[...document.querySelectorAll('body *')].filter(e => e.getClientRects().length"
            f" && e.getBoundingClientRect().right > {width} + 0.5).map(e => e.outerHTML)"
        )
        assert beyond == []
        assert browser.problems == []
        asked = [u for u in browser.asked if not u.startswith(("data:", page.as_uri()))]
        assert asked == []
        # a value of a curve is shown under the pointer
        browser.value("document.querySelector('svg.plot').scrollIntoView({behavior: 'instant'})")
        circle = "document.querySelector('svg.plot circle.value').getBoundingClientRect()"
        x, y = browser.value(f"(r => [r.x + r.width / 2, r.y + r.height / 2])({circle})")
        browser.mouse("mouseMoved", x + 3, y + 3)
        browser.wait_for("!document.querySelector('.tip').hidden")
        assert "%" in browser.value("document.querySelector('.tip').textContent")

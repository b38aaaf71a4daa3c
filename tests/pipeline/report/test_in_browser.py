"""The report in a real browser, Debian's chromium without a screen.

apt-get install --no-install-recommends chromium
pytest -m slow tests/pipeline/report/test_in_browser.py
"""

import base64
import io
import shutil

import numpy as np
import pytest
from PIL import Image

from pipeline.report import picture_set, report
from tests.pipeline.report.browser import MISSING, Browser
from tests.pipeline.report.run_folders import pin_mesh, scene_of, write_run

pytestmark = pytest.mark.slow

SIZES = [(1100, False), (1100, True), (390, False), (390, True)]
"""Widths of the window, and whether the reader prefers dark pages."""


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    if shutil.which("chromium") is None:
        pytest.fail(MISSING, pytrace=False)
    path = tmp_path_factory.mktemp("browser") / "run"
    write_run(path, scene_of(hold=["all"]), *pin_mesh())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(picture_set, "ENOUGH_CELLS", 5000)
        return report.write_report(path)


@pytest.fixture(scope="module")
def browser(page, tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("chromium")) as browser:
        yield browser


def opened(browser, page, width, dark):
    """The page in a window, its solids drawn, the first of them in view."""
    browser.problems.clear()
    browser.asked.clear()
    browser.show(page, width, 900, dark)
    browser.wait_for("document.querySelector('#solid.ready, #solid.failed')")
    assert browser.value("document.querySelector('#solid').className") == "ready"
    browser.value("document.getElementById('solid').scrollIntoView({behavior: 'instant'})")
    settled(browser)


def settled(browser):
    """Wait until what was asked for is on the screen."""
    wait = "new Promise(f => requestAnimationFrame(() => requestAnimationFrame(f)))"
    browser.value(f"{wait}.then(() => true)")


def put(browser, name, value):
    """Move a slider, or choose, as a reader does."""
    browser.value(
        f"(e => {{ e.value = '{value}'; e.dispatchEvent(new Event('input')); }})"
        f"(document.querySelector('#solid [name={name}]'))"
    )
    settled(browser)


def canvases(browser):
    """What the canvases show, (height, width, 4) each."""
    urls = browser.value(
        "[...document.querySelectorAll('#solid canvas')].map(c => c.toDataURL('image/png'))"
    )
    found = []
    for url in urls:
        with Image.open(io.BytesIO(base64.b64decode(url.partition(",")[2]))) as picture:
            found.append(np.asarray(picture.convert("RGBA")).astype(int))
    return found


def metal(picture):
    """Pixels that metal covers; the shell around it is translucent."""
    return int((picture[..., 3] > 250).sum())


@pytest.mark.parametrize("width, dark", SIZES)
def test_nothing_is_cut_asked_for_or_complained_of(browser, page, width, dark):
    opened(browser, page, width, dark)
    wide = browser.value("document.documentElement.scrollWidth")
    assert wide == width
    cut = browser.value(
        "[...document.querySelectorAll('.wide, td, figure, .controls > *')]"
        ".filter(e => e.scrollWidth > e.clientWidth + 1).map(e => e.outerHTML.slice(0, 200))"
    )
    assert cut == []
    beyond = browser.value(
        "[...document.querySelectorAll('body *')].filter(e => e.getClientRects().length"
        f" && e.getBoundingClientRect().right > {width} + 0.5).map(e => e.outerHTML.slice(0, 200))"
    )
    assert beyond == []
    assert browser.problems == []
    assert [url for url in browser.asked if not url.startswith(("data:", page.as_uri()))] == []
    lightness = browser.value("getComputedStyle(document.body).backgroundColor")
    assert lightness == ("rgb(20, 24, 30)" if dark else "rgb(255, 255, 255)")


@pytest.mark.parametrize("width, dark", SIZES[:2])
def test_the_slider_shows_less_metal_later(browser, page, width, dark):
    opened(browser, page, width, dark)
    shown = []
    for step in (0, 1, 1.5, 2, 3):
        put(browser, "time", step)
        shown.append([metal(picture) for picture in canvases(browser)])
    shown = np.array(shown)
    assert shown.shape == (5, 2) and (shown[0] > 10_000).all()
    assert (shown[0] == shown[0, 0]).all()  # the same solid before immersion
    # each alloy has less metal in its outline from time to time; a severed one has some left
    assert (np.diff(shown, axis=0) <= 0).all() and (shown[-1] < 0.97 * shown[0]).all()
    assert (np.diff(shown[:, 0]) < 0).any()
    label = "document.querySelector('#solid output').textContent"
    assert browser.value(label) == "24 weeks"
    put(browser, "time", 1.5)
    assert browser.value(label) == "6 weeks, between computed times"


def test_the_cut_shows_the_inside_and_the_solids_turn_together(browser, page):
    opened(browser, page, 1100, False)
    whole = canvases(browser)
    put(browser, "cut", "front")
    half = canvases(browser)
    assert all((a != b).any(axis=2).mean() > 0.05 for a, b in zip(whole, half, strict=True))
    put(browser, "depth", -1)
    assert all(
        metal(picture) < 0.02 * metal(one)
        for picture, one in zip(canvases(browser), half, strict=True)
    )
    put(browser, "depth", 1)
    assert all(np.abs(a - b).max() < 3 for a, b in zip(canvases(browser), whole, strict=True))
    box = "document.querySelector('#solid canvas').getBoundingClientRect()"
    x, y = browser.value(f"(r => [r.x + r.width / 2, r.y + r.height / 2])({box})")
    browser.mouse("mousePressed", x, y, pressed=True)
    browser.mouse("mouseMoved", x + 70, y + 20, pressed=True)
    browser.mouse("mouseReleased", x + 70, y + 20)
    settled(browser)
    turned = canvases(browser)
    assert all((a != b).any(axis=2).mean() > 0.05 for a, b in zip(whole, turned, strict=True))


def test_values_are_shown_under_the_pointer(browser, page):
    opened(browser, page, 1100, False)
    tip = "document.querySelector('.tip').hidden ? '' : document.querySelector('.tip').textContent"
    put(browser, "time", 0)
    box = "document.querySelector('#solid canvas').getBoundingClientRect()"
    x, y = browser.value(f"(r => [r.x + r.width / 2, r.y + r.height / 2])({box})")
    browser.mouse("mouseMoved", x, y)
    settled(browser)
    assert browser.value(tip) == "damage 0.00: 100 % of the strength left here"
    browser.value("document.getElementById('curves').scrollIntoView({behavior: 'instant'})")
    circle = "document.querySelectorAll('#curves circle.value')[2].getBoundingClientRect()"
    x, y = browser.value(f"(r => [r.x + r.width / 2, r.y + r.height / 2])({circle})")
    browser.mouse("mouseMoved", x + 4, y + 3)
    settled(browser)
    assert browser.value(tip).startswith("Mg-5Gd, 8 weeks: 43.0 % left, ")


def test_a_picture_enlarges_and_a_table_can_be_kept(browser, page):
    opened(browser, page, 390, False)
    small = browser.value("document.querySelector('.screws img').getBoundingClientRect().height")
    browser.value("document.querySelector('.screws img').click()")
    settled(browser)
    large = browser.value(
        "document.querySelector('dialog[open] img').getBoundingClientRect().toJSON()"
    )
    assert large["height"] > 2 * small and large["right"] <= 390
    browser.value("document.querySelector('dialog').click()")
    assert browser.value("document.querySelector('dialog').open") is False
    text = browser.value("atob(document.querySelector('a[download]').href.split(',')[1])")
    assert text == (page.parent / "summary.csv").read_text()
    assert browser.problems == []

"""Pages in a real browser: Chromium loads the files from disk, as a reader does."""

import base64
import contextlib
import io
import os
import re
import shutil
import time
from dataclasses import replace
from types import SimpleNamespace

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from leglab.diagnosis.result import Estimate
from leglab.report.comparison.page import write_comparison_page
from leglab.report.diagnosis.page import write_page
from leglab.report.folder_index import write_index
from leglab.report.page.shell import asset
from leglab.report.run.page import write_report
from leglab.report.style import SERIES
from leglab.report.sweep.page import write_sweep_page
from leglab.runs.folder import read_runs
from tests.helpers import page_watch
from tests.helpers.comparison_folders import write_comparison
from tests.helpers.made_up_diagnosis import CALIBRATION, diagnosis, effect
from tests.helpers.report_folders import HOSTILE, write_folder
from tests.helpers.sweep_folders import write_sweep

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
PAGES = ("report", "index", "diagnosis", "hostile", "sweep", "comparison")
DESKTOP, PHONE = {"width": 1100, "height": 900}, {"width": 360, "height": 740}


@pytest.fixture(scope="module")
def browser():
    api = pytest.importorskip("playwright.sync_api")
    if CHROMIUM is None:
        pytest.skip("no chromium on this machine; sudo apt-get install -y chromium")
    with api.sync_playwright() as playwright:
        # Chromium's own sandbox does not start for root, as whom containers run.
        sandbox = os.geteuid() != 0
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, chromium_sandbox=sandbox, args=["--disable-gpu"]
        )
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """A report of two runs with a film, an index, a diagnosis, and a report of hostile names."""
    root = tmp_path_factory.mktemp("pages")
    folders = [
        write_folder(root / "pd", "pd", before=0.02, after=0.04),
        write_folder(root / "arx", "arx", before=0.002, after=0.01, damage=0.02, t90=1.5),
    ]
    report = write_report(read_runs(folders), root / "report", filmer=_film).page
    bad = write_folder(root / "bad", HOSTILE, scenario=HOSTILE, joints=(HOSTILE, "knee"))
    hostile = write_report(read_runs([bad]), root / "hostile", filmer=None).page
    (root / "diagnosis").mkdir()
    found = write_page(diagnosis("confusion_set"), root / "diagnosis", model="knee_bench")
    write_folder(root / "slow", "pd", seed=10, after=0.2, stopped=8.0)
    write_folder(root / "quick", "oracle", seed=9, after=0.005)
    leakage = {"parameters.internal_leakage": [1e-13, 1e-12]}
    write_sweep(root / "sweep", (HOSTILE, "bsnn_arx"), failed=(3,), more=leakage)
    write_comparison(root / "comparison", failed=("pd",))
    comparison = write_comparison_page(root / "comparison")
    sweep = write_sweep_page(root / "sweep")
    _, index = write_index(root, root / "index.html")
    return SimpleNamespace(
        sweep=sweep,
        report=report,
        hostile=hostile,
        diagnosis=found,
        index=index,
        comparison=comparison,
    )


def _film(path):
    """A real film of two seconds in which something moves."""
    writer = imageio_ffmpeg.write_frames(str(path), (320, 192), fps=30, codec="libx264")
    writer.send(None)
    for i in range(60):
        frame = np.zeros((192, 320, 3), np.uint8)
        frame[:, 5 * i : 5 * i + 20] = 255
        writer.send(frame.tobytes())
    writer.close()
    return path


@contextlib.contextmanager
def opened(browser, path, *, size=DESKTOP, scheme="light", **options):
    """A page that has complained of nothing and asked the network for nothing."""
    look = {"viewport": size, "color_scheme": scheme}
    with page_watch.watched(browser, **look, **options) as (page, watch):
        page_watch.load(page, path)
        yield page
    assert watch.complaints == []
    assert watch.outward() == []
    assert sum(url.startswith("file:") for url in watch.requests) == 1


def until(page, condition, seconds=20.0):
    """Waits without `eval`, which the policy of the pages forbids."""
    end = time.monotonic() + seconds
    while not page.evaluate(condition):
        assert time.monotonic() < end, condition
        page.wait_for_timeout(30)


def drawn_curves(page, plot):
    return page.locator(f"#plot-{plot} .scatterlayer .trace .js-line").evaluate_all(
        "lines => lines.filter(line => getComputedStyle(line.closest('.trace')).opacity > 0.1)"
        ".map(line => line.getAttribute('d'))"
    )


def shown_span(page, plot):
    return page.evaluate(f"document.getElementById('plot-{plot}').layout.xaxis.range")


@pytest.fixture(scope="module")
def report(browser, pages):
    """The report, loaded once; what it complains of fails the last test that uses it."""
    with opened(browser, pages.report) as page:
        yield page


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.parametrize("look", ["desktop", "dark phone"])
def test_pages_are_accessible_and_never_scroll_sideways(browser, pages, name, look):
    size, scheme = (DESKTOP, "light") if look == "desktop" else (PHONE, "dark")
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    with opened(browser, getattr(pages, name), size=size, scheme=scheme) as page:
        width = page.evaluate("document.scrollingElement.scrollWidth")
        assert width <= size["width"]
        for details in page.locator("details").all():
            details.evaluate("part => { part.open = true }")
        found = axe.run(page)
        told = [f"{v['id']}: {v['nodes'][0]['html'][:200]}" for v in found.response["violations"]]
        assert told == []
        if name == "hostile":
            assert page.evaluate("window.hit") is None
            assert page.locator("img").count() == 0


def test_the_dark_page_is_dark_in_its_plots_as_well(browser, pages):
    with opened(browser, pages.report, scheme="dark") as page:

        def look():
            return page.evaluate(
                """() => [getComputedStyle(document.body).backgroundColor,
                document.getElementById("plot-error").data[0].line.color,
                document.getElementById("plot-error").layout.font.color]"""
            )

        assert look() == ["rgb(26, 26, 26)", "#F2F2F2", "#e8e8e8"]
        page.emulate_media(color_scheme="light")
        until(page, "document.getElementById('plot-error').layout.font.color === '#1b1b1b'")
        assert look() == ["rgb(255, 255, 255)", "#000000", "#1b1b1b"]


def test_curves_of_pictures_are_seen_in_the_dark(browser):
    colors = "".join(
        f'<rect width="9" height="9" x="{9 * i}" fill="{c}"/>' for i, c in enumerate(SERIES)
    )
    back = '<rect width="90" height="9" fill="white"/>'
    drawn = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 90 9">{back}{colors}</svg>'
    data = base64.b64encode(drawn.encode()).decode()
    with page_watch.watched(browser, viewport=DESKTOP, color_scheme="dark") as (page, _):
        page.set_content(
            f"<style>{asset('page.css')}</style><img src='data:image/svg+xml;base64,{data}'>"
        )
        shot = page.locator("img").screenshot()
        paper = page.evaluate("getComputedStyle(document.body).backgroundColor")
    pixels = np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"))
    at = [pixels[pixels.shape[0] // 2, pixels.shape[1] * (2 * i + 1) // 20] for i in range(10)]
    assert paper == f"rgb({', '.join(str(v) for v in at[-1])})"
    for color, pixel in zip(SERIES, at, strict=False):
        assert _contrast(pixel, at[-1]) > 4.5, color


def _contrast(one, other):
    """Ratio of luminances as WCAG 2 defines it."""

    def luminance(rgb):
        share = np.asarray(rgb) / 255.0
        linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
        return float(linear @ (0.2126, 0.7152, 0.0722)) + 0.05

    return max(luminance(one), luminance(other)) / min(luminance(one), luminance(other))


def test_the_film_plays_from_the_page_alone(browser, pages, tmp_path):
    alone = tmp_path / "alone.html"
    shutil.copy(pages.report, alone)
    with opened(browser, alone) as page:
        video = page.locator("video")
        assert video.evaluate("film => film.disableRemotePlayback")
        assert video.get_attribute("aria-describedby") == "film-text"
        assert "pd and arx, side by side" in page.locator("#film-text").inner_text()
        # A still from the film stands there before it is played.
        size = page.evaluate(
            """async () => {
                const still = new Image();
                still.src = document.querySelector("video").poster;
                await still.decode();
                return [still.naturalWidth, still.naturalHeight];
            }"""
        )
        assert size == [320, 192]
        page.evaluate("document.querySelector('video').play()")
        until(page, "document.querySelector('video').currentTime > 0.3")
        assert page.evaluate("document.querySelector('video').videoWidth") == 320
        assert page.evaluate("document.querySelector('video').duration") == pytest.approx(
            2, abs=0.1
        )


def test_a_click_on_a_legend_hides_a_curve_and_another_brings_it_back(report):
    page = report
    assert len(drawn_curves(page, "deviation")) == 2
    page.locator("#plot-deviation .legendtoggle").nth(1).click()
    until(page, "document.getElementById('plot-deviation').data[1].visible === 'legendonly'")
    assert len(drawn_curves(page, "deviation")) == 1
    assert len(drawn_curves(page, "angle")) == 3
    page.wait_for_timeout(400)  # two clicks in short order are a double click
    page.locator("#plot-deviation .legendtoggle").nth(1).click()
    until(page, "document.getElementById('plot-deviation').data[1].visible === true")
    assert len(drawn_curves(page, "deviation")) == 2


def test_a_run_is_taken_out_of_all_plots_with_the_keyboard(report):
    page = report
    box = page.get_by_role("checkbox", name="pd")
    box.focus()
    page.keyboard.press("Space")
    until(page, "document.getElementById('plot-angle').data.length === 2")
    names = page.evaluate("document.getElementById('plot-angle').data.map(d => d.name)")
    assert names == ["reference", "arx"]
    assert len(drawn_curves(page, "error")) == 1
    page.keyboard.press("Space")
    until(page, "document.getElementById('plot-angle').data.length === 3")


def test_dragging_over_one_plot_zooms_all_and_the_buttons_bring_time_back(report):
    page = report
    assert shown_span(page, "command") == pytest.approx([0, 10], abs=0.01)
    canvas = page.locator("#plot-deviation .nsewdrag").first
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    y = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + 0.2 * box["width"], y)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.4 * box["width"], y, steps=5)
    page.mouse.up()
    until(page, "document.getElementById('plot-command').layout.xaxis.range[1] < 5")
    for plot in ("error", "deviation", "angle", "command", "pressure"):
        assert shown_span(page, plot) == pytest.approx([2.0, 4.0], abs=0.1)
    page.get_by_role("button", name="Around the change").click()
    until(page, "document.getElementById('plot-error').layout.xaxis.range[0] === 3")
    assert shown_span(page, "pressure") == [3, 7]
    page.get_by_role("button", name="Whole time").click()
    until(page, "document.getElementById('plot-error').layout.xaxis.range[0] === 0")


def test_hovering_tells_the_values_of_all_runs(report):
    page = report
    canvas = page.locator("#plot-deviation .nsewdrag").first
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    page.mouse.move(box["x"] + 0.7 * box["width"], box["y"] + box["height"] / 2)
    page.wait_for_selector("#plot-deviation .hoverlayer text")
    told = " ".join(page.locator("#plot-deviation .hoverlayer text").all_text_contents())
    assert re.search(r"pd : .*mrad", told)
    assert re.search(r"arx : .*mrad", told)


def test_another_joint_is_drawn_when_it_is_chosen(report):
    page = report
    before = drawn_curves(page, "angle")
    assert "hip" in page.locator("#plot-angle-title").inner_text()
    page.locator("#joint").select_option("knee")
    until(page, "document.querySelector('#plot-angle-title .joint').textContent === 'knee'")
    page.wait_for_timeout(300)
    assert drawn_curves(page, "angle") != before


def test_the_index_filters_and_sorts(browser, pages):
    with opened(browser, pages.index) as page:
        rows = page.locator("#entries tbody tr:visible")

        def column(i):
            return [row.locator("th, td").nth(i).inner_text() for row in rows.all()]

        count = rows.count()
        page.get_by_role("searchbox", name="Filter").fill("seal_wear pd")
        assert all("pd" in text for text in column(3))
        assert rows.count() == 3
        assert page.get_by_role("status").inner_text() == "3 shown"
        page.get_by_role("searchbox", name="Filter").fill("")
        assert rows.count() == count
        page.get_by_role("button", name="RMS after").click()
        values = [float(value) for value in column(7) if value]
        assert values == sorted(values)
        assert len(values) == 5
        assert column(7)[-1] == ""  # what has none comes last, both ways
        page.get_by_role("button", name="RMS after").focus()
        page.keyboard.press("Enter")
        assert [float(value) for value in column(7) if value] == values[::-1]
        assert column(7)[-1] == ""
        head = page.get_by_role("columnheader", name="RMS after")
        assert head.get_attribute("aria-sort") == "descending"
        page.get_by_role("button", name="seed").click()
        seeds = [int(value) for value in column(5) if value]
        assert seeds == sorted(seeds)


def test_the_page_prints_with_its_folded_tables(report):
    page = report
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert page.evaluate("document.querySelector('details').open")
    page.emulate_media(media="print")
    assert not page.locator("#controls").is_visible()
    assert not page.locator("video").is_visible()
    assert page.locator("h1").is_visible()


TOOLS = ["download plot as a png", "zoom", "pan", "zoom in", "zoom out", "reset axes"]
FOCUSABLE = "a[href], button, input, select, summary, video, [tabindex='0']"


def test_the_toolbar_of_a_plot_holds_what_it_was_given(browser, pages):
    with opened(browser, pages.report) as page:
        bars = page.locator(".modebar")
        assert bars.count() == page.locator(".canvas").count() == 6
        for bar in bars.all():
            tools = bar.locator(".modebar-btn").evaluate_all("all => all.map(b => b.dataset.title)")
            assert [tool.lower() for tool in tools] == TOOLS
            assert bar.locator("[href]").count() == 0


def test_on_a_phone_no_toolbar_covers_a_heading_and_the_film_is_seen_whole(browser, pages):
    with opened(browser, pages.report, size=PHONE) as page:
        assert page.locator(".modebar").count() == 6
        assert page.locator(".modebar:visible").count() == 0
        film = page.locator("video").bounding_box()
        assert 0.9 * PHONE["width"] <= film["x"] + film["width"] <= PHONE["width"]
        # Its text can be read when it fills the screen.
        assert page.locator("video").get_attribute("controls")


def test_on_a_phone_the_index_hides_nothing(browser, pages):
    with opened(browser, pages.index, size=PHONE, scheme="dark") as page:
        rows = page.locator("#entries tbody tr")
        outcomes = page.locator("td.outcome", has_text=re.compile(".")).all()
        assert len(outcomes) >= 5
        for part in [*outcomes, *page.locator("td[data-name]:visible").all()]:
            box = part.bounding_box()
            assert box["x"] >= 0
            assert box["x"] + box["width"] <= PHONE["width"]
        for outcome in outcomes:
            own = outcome.evaluate("part => [part.scrollWidth, part.clientWidth]")
            assert own[0] <= own[1] + 1
        page.get_by_role("searchbox", name="Filter").fill("seal_wear pd")
        assert rows.filter(visible=True).count() == 3
        page.get_by_role("button", name="RMS after").click()
        values = page.locator("tr:not([hidden]) td[data-name='RMS after']").all_inner_texts()
        assert [float(v) for v in values if v] == sorted(float(v) for v in values if v)


def test_at_1400_pixels_no_table_of_a_diagnosis_is_cut(browser, tmp_path):
    def estimate(name, unit):
        return Estimate(name=name, unit=unit, value=-3.22, nominal=-0.0771, interval=(-4.86, -1.59))

    found = replace(
        effect("asymmetric_friction", "left_knee_actuator"),
        parameters=(
            estimate("viscous_forward_less_backward", "N m s/rad"),
            estimate("coulomb_forward_less_backward", "N m"),
        ),
    )
    result = diagnosis(effects=(found,), traces=(), whole=None, calibration=CALIBRATION)
    page_of = write_page(result, tmp_path, model="knee_bench")
    with opened(browser, page_of, size={"width": 1400, "height": 900}) as page:
        cut = page.locator(".wide:has(table)").evaluate_all(
            "all => all.filter(p => p.scrollWidth > p.clientWidth).map(p => p.ariaLabel)"
        )
        assert cut == []


def test_a_word_leads_to_its_meaning_by_keyboard(browser, pages):
    with opened(browser, pages.diagnosis) as page:
        word = page.get_by_role("link", name="noise levels").first
        assert "what noise alone gives" in word.get_attribute("title")
        word.focus()
        page.keyboard.press("Enter")
        until(page, "location.hash === '#word-noise-level'")
        assert page.locator("#word-noise-level").bounding_box()["y"] < DESKTOP["height"]


@pytest.mark.slow("hundreds of clicks in a browser")
@pytest.mark.parametrize("name", ["report", "diagnosis", "index"])
def test_nothing_that_can_be_pressed_sends_anything(browser, pages, name):
    path = getattr(pages, name)
    with page_watch.watched(browser, viewport=DESKTOP) as (page, watch):
        page_watch.load(page, path)
        pressed = page_watch.press_by_mouse(page)
        film = page_watch.press_film_controls(page) if name == "report" else ()
        page_watch.choose_everything(page)
        reached, missed = page_watch.press_by_keys(page, FOCUSABLE)
    assert watch.outward() == []
    assert [url for url in watch.requests if url.startswith("file:")] == [path.as_uri()]
    # The library warns of a format where the ends of an axis are pressed to one place.
    assert [told for told in watch.complaints if not told.startswith("WARN: ")] == []
    links = re.findall(r"link:(\S+)", " ".join(pressed))
    assert [link for link in links if not link.startswith(f"{path.as_uri()}#")] == []
    assert len(pressed) >= {"report": 120, "diagnosis": 4, "index": 12}[name]
    assert missed == []
    assert reached >= {"report": 40, "diagnosis": 4, "index": 12}[name]
    if name == "report":
        assert any("download" in part for part in film)
        assert any("legendtoggle" in part for part in pressed)
        tools = " ".join(part.lower() for part in pressed if "modebar-btn" in part)
        assert all(tool in tools for tool in TOOLS)
        assert len(watch.downloads) >= 6  # pictures of the plots, saved from the page


@pytest.mark.parametrize("name", ["report", "diagnosis", "index"])
def test_links_lead_to_files_beside_the_page(browser, pages, name):
    path = getattr(pages, name)
    with page_watch.watched(browser) as (page, watch):
        page_watch.load(page, path)
        links = page_watch.linked_files(page)
        for i, link in enumerate(links):
            assert link.startswith(path.parent.as_uri())
            page.locator("a[href]:not([href^='#'])").nth(i).click()
            page.wait_for_timeout(300)
            page_watch.load(page, path)
    assert links
    assert watch.outward() == []


@pytest.mark.slow("dozens of attempts of a browser")
def test_what_a_page_without_a_policy_tries_is_seen(browser, tmp_path):
    bare = tmp_path / "bare.html"
    bare.write_text("<!DOCTYPE html><title>bare</title><p>bare</p>")
    tried = [*page_watch.STAYING, *page_watch.LEAVING]
    with page_watch.watched(browser) as (page, watch):
        page_watch.load(page, bare)
        page_watch.attempt(page, tried)
    hosts = re.findall(r"[/ ]([\w-]+)\.example", " ".join(watch.wire))
    assert set(tried) - set(hosts) == set()
    assert len(watch.windows) == 4


@pytest.mark.slow("dozens of attempts of a browser")
@pytest.mark.parametrize("name", ["report", "diagnosis", "index"])
def test_nothing_that_a_page_tries_comes_out(browser, pages, name):
    # No script runs on the page of a diagnosis, so that none can lead away from it.
    ways = page_watch.FORMS if name == "diagnosis" else page_watch.LEAVING
    with page_watch.watched(browser) as (page, watch):
        page_watch.load(page, getattr(pages, name))
        page_watch.attempt(page, [*page_watch.STAYING, *ways])
        assert page.evaluate("document.baseURI") == getattr(pages, name).as_uri()
    assert watch.sent() == []
    # The window of a form opens before what was to be sent there is blocked.
    assert len(watch.windows) == 1

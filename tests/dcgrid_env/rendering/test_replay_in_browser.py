"""The page of a replay in a real browser: the system's Chromium, driven by Playwright."""

import importlib
import importlib.util
import re
import shutil

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.baselines import make_controller, rollout
from dcgrid_env.core.suggestions import from_clone
from dcgrid_env.rendering import replay
from dcgrid_env.rendering.replay_terms import TERMS

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
MISSING = [name for name in ("plotly", "playwright") if importlib.util.find_spec(name) is None]
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(bool(MISSING), reason=f"not installed: {', '.join(MISSING)}; {from_clone('replay,browser')}"),
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here; apt-get install chromium"),
]
TIMEOUT_MS = 120_000  # a busy machine is no failure


@pytest.fixture(scope="module")
def browser():
    with importlib.import_module("playwright.sync_api").sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield started
        started.close()


@pytest.fixture
def page(browser, tmp_path, request):
    """A replay opened from disk without a network, and what its console said."""
    scenario, controllers, width, height = request.param
    s = make_scenario(scenario, split="test")
    runs = {name: rollout(s, make_controller(name, s), [0]).series(0) for name in controllers}
    path = replay(runs).write(tmp_path / "replay.html")
    context = browser.new_context(viewport={"width": width, "height": height}, offline=True)
    opened, said = context.new_page(), []
    opened.set_default_timeout(TIMEOUT_MS)
    opened.on("console", lambda message: said.append(message.text) if message.type in ("error", "warning") else None)
    opened.on("pageerror", lambda error: said.append(str(error)))
    opened.goto(path.as_uri())
    opened.wait_for_selector("#message", state="hidden")
    yield opened
    assert said == []
    context.close()


def fills(page, run=0):
    """Colours of all marks of a map."""
    return (
        page.locator(".map")
        .nth(run)
        .evaluate("map => [...map.querySelectorAll('path.point')].map(mark => mark.style.fill)")
    )


def spoiled(browser, path, text, said):
    """Return the text that a damaged page shows."""
    path.write_text(text)
    opened = browser.new_page()
    opened.goto(path.as_uri())
    opened.wait_for_function("text => document.getElementById('message').textContent.includes(text)", arg=said)
    shown = opened.locator("body").inner_text()
    opened.close()
    return shown


def clock(page):
    return page.locator("#clock").inner_text()


LAPTOP, PHONE = (1366, 768), (390, 844)


@pytest.mark.parametrize("page", [("ieee33-weak", ("none", "droop-tuned"), *LAPTOP)], indirect=True)
def test_slider_click_and_keys(page):
    before, cost = fills(page), page.locator(".j").first.inner_text()
    page.locator("#time").fill("60")
    assert clock(page) == "t = 60 of 120 s"
    assert fills(page) != before
    assert page.locator(".j").first.inner_text() != cost
    assert fills(page, 0) != fills(page, 1)  # the controllers differ

    assert page.locator("#hint").inner_text() == "Click or tap a bus to see its curves, or choose it in the list."
    begun = page.locator("#selected-title").inner_text()
    box = page.locator(".map").first.locator("path.point").last.bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    chosen = page.locator("#selected-title").inner_text()
    assert chosen != begun
    assert not page.locator("#hint").is_visible()
    assert chosen.startswith("Bus 33 (dc_1)")  # the last in the feeder's file
    assert "bus 33: voltage" in page.locator(".reading").first.inner_text()
    assert re.search(r"bus 33\nvoltage .*\sp.u.\ndc_1: power drawn .*\skW", page.locator("#tip").text_content())
    assert "dc_1: GPU clock (MHz)" in page.locator("#names").text_content()

    curves = page.locator("#curves")
    drawn = curves.evaluate("one => one.data.filter(line => line.xaxis === 'x2').map(line => [...line.y])")
    s = make_scenario("ieee33-weak", split="test")
    run = rollout(s, make_controller("none"), [0]).series(0)
    sites_kw = run.p_kw_from_reset[:, : s.datacenters.count].sum(axis=1)
    assert len(drawn) == 3  # demand, and two controllers
    for of_none in drawn[:2]:  # at the top clock the demand is drawn
        np.testing.assert_allclose(of_none, sites_kw, atol=0.2)
    cursors = curves.evaluate("one => one.layout.shapes.map(line => line.x0)")
    assert len(cursors) == 7
    assert set(cursors) == {60}

    page.keyboard.press("Home")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Shift+ArrowRight")
    page.keyboard.press("ArrowLeft")
    assert clock(page) == "t = 10 of 120 s"
    page.keyboard.press(" ")
    page.wait_for_function("document.getElementById('time').value > 11")
    page.keyboard.press(" ")
    assert page.locator("#play").get_attribute("aria-label") == "play"
    page.keyboard.press("End")
    assert clock(page) == "t = 120 of 120 s"
    page.locator("#play").focus()
    order = []
    for _ in range(5):
        page.keyboard.press("Tab")
        order.append(page.evaluate("document.activeElement.id"))
    assert order == ["back", "forward", "time", "speed", "bus"]


@pytest.mark.parametrize("page", [("toy6", ("none",), *LAPTOP)], indirect=True)
def test_words_are_explained_under_the_pointer_and_in_focus(page):
    tip, words = page.locator("#tip"), page.locator("#legend .term")
    words.get_by_text("backlog").hover()
    assert tip.inner_text() == TERMS["backlog"]
    page.keyboard.press("Escape")
    assert not tip.is_visible()
    words.first.focus()
    assert tip.inner_text() == TERMS["p.u."]
    page.keyboard.press("Tab")
    assert tip.inner_text() == TERMS["violation"]
    shown = {"J", "p.u.", "violation", "band", "substation", "clock", "backlog", "demand"}
    assert shown <= set(page.locator(".term").all_inner_texts()) <= set(TERMS)


def test_a_page_that_cannot_be_drawn_says_why(browser, tmp_path):
    s = make_scenario("toy6", split="test", horizon=2)
    text = replay(rollout(s, make_controller("none"), [0]).series(0)).html
    file = tmp_path / "spoiled.html"
    cut = "The replay could not be opened: this file is incomplete, or this browser is older than 2023."
    assert spoiled(browser, file, text[: len(text) // 2], "incomplete") == cut
    damaged = re.sub(r'(id="data">.{40}).{4}', r"\1AAAA", text)
    assert "the data in this file are damaged" in spoiled(browser, file, damaged, "damaged")
    still = browser.new_context(java_script_enabled=False).new_page()
    still.goto(file.as_uri())
    assert still.locator("#message").inner_text() == "This page needs JavaScript, which is disabled here."
    assert text.index("Loading the replay") < text.index('id="plotly"')  # shown before the large parts arrive


@pytest.mark.parametrize("page", [("ieee123-3ph", ("droop",), *PHONE)], indirect=True)
def test_phases_on_a_phone(page):
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE[0]
    s = make_scenario("ieee123-3ph", split="test")
    marks = set(fills(page))
    assert len(marks) > 20  # every phase has its colour
    assert "phases: a top, b right, c left" in page.locator("#legend").text_content()
    assert str(s.feeder.network.regulator.bank[0]) in page.locator(".map").first.text_content()
    page.locator("#bus").select_option("5")
    assert page.locator("#selected-title").inner_text().startswith(f"Bus {s.feeder.bus_ids[5]}")


@pytest.mark.parametrize("page", [("ride-through", ("droop",), *LAPTOP)], indirect=True)
def test_what_has_left_the_grid_is_crossed_out(page):
    state = page.locator(".state").first
    assert "on the grid" not in state.inner_text()
    page.locator("#time").fill("30")
    assert "on the grid: dc_0" in state.inner_text()
    assert "dc_0 off" in page.locator(".map").first.text_content()

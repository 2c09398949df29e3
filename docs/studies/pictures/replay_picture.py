"""Draw the picture of docs/replay.md, a replay as a laptop shows it.

Use: python -m docs.studies.pictures.replay_picture PATH.
"""

import shutil
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright  # pyright: ignore[reportMissingImports]

from dcgrid_env import make_scenario
from dcgrid_env.agents import find_controller
from dcgrid_env.baselines import rollout
from dcgrid_env.rendering import replay

scenario = make_scenario("ieee33-weak", split="test")
names = ("none", "droop-tuned", "ieee33-weak-analytic")
runs = {name: rollout(scenario, find_controller(name, scenario), [0]).series(0) for name in names}
with tempfile.TemporaryDirectory() as folder, sync_playwright() as driver:
    page = replay(runs).write(Path(folder) / "replay.html")
    browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
    opened = browser.new_page(viewport={"width": 1366, "height": 900})
    opened.goto(page.as_uri())
    opened.wait_for_selector("#message", state="hidden", timeout=120_000)
    opened.locator("#time").fill("80")
    opened.locator("#time").blur()
    opened.screenshot(path=sys.argv[1])
    browser.close()

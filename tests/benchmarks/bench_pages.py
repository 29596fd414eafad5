"""How soon pages stand: python tests/benchmarks/bench_pages.py [ROTORS] [READINGS] [BLADES]

A service on SQLite with the exact twin (BLADETWIN_SCIENCE=fake): so many rotors, and one of so many
blades with so many readings, written to its log before the service starts. Each page is opened
five times in headless Chromium; printed are the median and the longest time until it is drawn (aim:
3 s), and the size of what its requests answered. Then a page of the lists is scrolled through, a
frame at a time, and turned to the next: printed are the median, the 95th percentile and the longest
time between frames, and how long the next page took until it was drawn.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from statistics import median

import httpx
import numpy as np
from playwright.sync_api import sync_playwright

from core.observation import Inspection
from service.bootstrap import make_worker
from service.fake import FakeScience
from service.free_port import free_port
from service.handlers.inspections import Item, post_inspections
from service.handlers.models import register_builtins
from service.handlers.rotors import create_rotor
from service.ports import BladeRecord
from service.settings import Settings
from service.store.engine import open_engine
from service.store.migrate import migrate
from service.store.unit_of_work import SqlStore
from tests.browser.conftest import ARGS, find_chromium

PAGES = {
    "rotors": "/",
    "rotor": "/rotors/big",
    "readings": "/rotors/big/readings",
    "blade": "/rotors/big/blades/B001",
    "3-D": "/rotors/big/blades/B001/3d",
    "diagnoses": "/rotors/big/diagnoses",
    "model": "/models/rotor-blade",
    "operations": "/operations",
}
BATCH = 5000
LISTS = {"rotors": "Next", "readings": "Older"}
"""Pages of a list, and the button that leads on."""
FRAMES = 240
SCROLLED = """frames => new Promise(done => {
  const boxes = [document.scrollingElement, ...document.querySelectorAll(".scroll")];
  const times = [];
  let last = null;
  let way = 1;
  const step = now => {
    if (last !== null) times.push(now - last);
    last = now;
    for (const box of boxes) box.scrollBy(0, 40 * way);
    if (times.length % 60 === 59) way = -way;
    if (times.length < frames) requestAnimationFrame(step); else done(times);
  };
  requestAnimationFrame(step);
})"""
TURNED = """name => new Promise(done => {
  const list = document.querySelector("tbody");
  const begun = performance.now();
  const watch = new MutationObserver(() => {
    if (document.contains(list)) return;
    watch.disconnect();
    requestAnimationFrame(() => done(performance.now() - begun));
  });
  watch.observe(document.body, {childList: true, subtree: true});
  [...document.querySelectorAll("button")].find(one => one.textContent === name).click();
})"""


def fill(url: str, rotors: int, readings: int, blades: int) -> None:
    engine = open_engine(url)
    migrate(engine)
    store, science = SqlStore(engine), FakeScience()
    register_builtins(store, science)
    names = [f"B{i + 1:03d}" for i in range(blades)]
    slots = [BladeRecord(name, slot=str(i + 1)) for i, name in enumerate(names)]
    create_rotor(store, "big", "rotor-blade", slots, 64, 7)
    for i in range(rotors - 1):
        create_rotor(store, f"row-{i:04d}", "rotor-blade", [BladeRecord("B1")], 64, i)
    rng = np.random.default_rng(1)
    for start in range(0, readings, BATCH):
        hours = np.sort(rng.uniform(1000, 49_000, BATCH))
        items = [
            Item("", Inspection(f"i{start + k}", names[k % blades], "elongation", float(h),
                                np.array([0.5 * h / 50_000 + rng.normal(0, 0.02)])))
            for k, h in enumerate(hours[: readings - start])
        ]  # fmt: skip
        post_inspections(store, "big", items)
    make_worker(store, science, Settings(database_url=url, science="fake"), "fill").drain()
    store.close()


def look(url: str) -> None:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=find_chromium(), args=list(ARGS))
        for name, path in PAGES.items():
            times, sizes = [], []
            for _ in range(5):
                page = browser.new_context(viewport={"width": 1280, "height": 800}).new_page()
                begun = time.perf_counter()
                page.goto(url + path)
                page.wait_for_selector("body[data-state=ready]", state="attached")
                times.append(time.perf_counter() - begun)
                loaded = "performance.getEntriesByType('resource').map(r => r.encodedBodySize)"
                sizes.append(sum(page.evaluate(loaded)))
                page.context.close()
            told = f"{median(times):6.2f} s {max(times):6.2f} s {sizes[0] / 1000:8.0f} kB"
            print(f"{name:12s} {told}", flush=True)
        for name, button in LISTS.items():
            page = browser.new_context(viewport={"width": 1280, "height": 800}).new_page()
            page.goto(url + PAGES[name])
            page.wait_for_selector("body[data-state=ready]", state="attached")
            frames = np.array(page.evaluate(SCROLLED, FRAMES))
            turns = [page.evaluate(TURNED, button) for _ in range(10)]
            middle, high = np.percentile(frames, [50, 95])
            print(
                f"{name:12s} frame {middle:.1f} ms, 95 %: {high:.1f}, longest {frames.max():.0f}; "
                f"the next page {median(turns):.0f} ms, longest {max(turns):.0f}",
                flush=True,
            )
            page.context.close()
        browser.close()


def main() -> None:
    given = [int(one) for one in sys.argv[1:]]
    rotors, readings, blades = (given + [1000, 100_000, 100][len(given) :])[:3]
    with tempfile.TemporaryDirectory() as folder:
        database, port = f"sqlite:///{folder}/pages.db", free_port()
        begun = time.perf_counter()
        fill(database, rotors, readings, blades)
        took = time.perf_counter() - begun
        print(f"{rotors} rotors, {readings} readings, {blades} blades: written in {took:.0f} s")
        env = os.environ | {"BLADETWIN_DATABASE_URL": database, "BLADETWIN_PORT": str(port)}
        env |= {"BLADETWIN_SCIENCE": "fake", "BLADETWIN_LOG_LEVEL": "warning"}
        server = subprocess.Popen([sys.executable, "-P", "-m", "service.cli", "serve"], env=env)
        url = f"http://127.0.0.1:{port}"
        try:
            while True:
                try:
                    if httpx.get(f"{url}/readyz").status_code == 200:
                        break
                except httpx.TransportError:
                    time.sleep(0.2)
            look(url)
        finally:
            server.terminate()
            server.wait(30)


if __name__ == "__main__":
    main()

"""How soon a posted reading is seen on a page that is open.

    python tests/benchmarks/bench_news.py [READINGS]

A service on SQLite with the blade physics, a rotor of 100 blades of 10,000 particles that has the
first outage's elongations. In headless Chromium a blade's page stays open; a reading of the blade
is posted, and the clock runs from its acknowledgement until its row stands in the table (aim: 1 s)
and until a version that rests on it heads the list of versions. READINGS blades, one after the
other, each once the posterior is sealed again.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from playwright.sync_api import sync_playwright

from service.client import Client
from service.free_port import free_port
from service.settings import Settings
from service.studies.load.run import serving
from tests.benchmarks.bench_update import NAMES, elongations
from tests.browser.conftest import ARGS, find_chromium

SEEN = """([id, version]) => {
  const rows = [...document.querySelectorAll("tbody tr")];
  const row = rows.some((one) => one.textContent.includes(id));
  const newest = document.querySelector('[aria-label="Versions"] tbody tr td');
  return [row, newest !== null && Number(newest.textContent) > version];
}"""
PATIENCE_S = 60.0


def main(count: int) -> None:
    first = elongations(1)
    more = elongations(2)[len(first) :][:count]
    told = [
        {"id": r.id, "blade": r.blade, "quantity": "elongation", "time_h": r.time_h,
         "value": float(r.values[0])} for r in (*first, *more)
    ]  # fmt: skip
    rows, versions = [], []
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        settings = Settings.load(
            {}, database_url=f"sqlite:///{folder}/n.db", port=free_port(), log_level="warning"
        )
        url = f"http://127.0.0.1:{settings.port}"
        with serving(settings, Path(folder) / "log"), Client(url) as twin:
            twin.ready(60)
            twin.create_rotor("r", blades=NAMES, particles=10_000)
            twin.wait_for("r", twin.post_inspections("r", told[: len(first)]))
            browser = playwright.chromium.launch(executable_path=find_chromium(), args=list(ARGS))
            for one in told[len(first) :]:
                version = twin.wait_sealed("r")["version"]
                page = browser.new_context(viewport={"width": 1280, "height": 800}).new_page()
                page.goto(f"{url}/rotors/r/blades/{one['blade']}")
                page.wait_for_selector("body[data-state=ready]", state="attached")
                page.wait_for_timeout(1000)
                twin.post_inspections("r", [one])
                begun, row = time.perf_counter(), 0.0
                while time.perf_counter() - begun < PATIENCE_S:
                    seen = page.evaluate(SEEN, [one["id"], version])
                    row = row or (time.perf_counter() - begun if seen[0] else 0.0)
                    if all(seen):
                        break
                    time.sleep(0.01)
                rows.append(row)
                versions.append(time.perf_counter() - begun)
                page.context.close()
            browser.close()
    for name, values in {"its row": rows, "a version with it": versions}.items():
        print(f"{name}: median {np.median(values):.2f}, most of {len(values)} {max(values):.2f} s")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)

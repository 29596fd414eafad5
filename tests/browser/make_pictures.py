"""The pictures of pages in the README, of the main job's rotor.

`bladetwin demo --keep` in one terminal, and with the address that it prints in another:

    python -m tests.browser.make_pictures http://127.0.0.1:8000
"""

from __future__ import annotations

import sys
from io import BytesIO
from pathlib import Path

from PIL import Image
from playwright.sync_api import expect, sync_playwright

from tests.browser.conftest import ARGS, find_chromium

RESULTS = Path(__file__).parents[1] / "claims" / "results" / "main-job"
PICTURES = {
    "rotor": ("/rotors/demo?limit=0.9", (1280, 1150)),
    "blade": ("/rotors/demo/blades/B001?limit=0.9", (1280, 1250)),
}
"""Name of each picture: the page, and how much of it is seen."""


def main(url: str) -> None:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=find_chromium(), args=list(ARGS))
        for name, (path, (width, height)) in PICTURES.items():
            page = browser.new_page(viewport={"width": width, "height": height})
            page.goto(url.rstrip("/") + path)
            page.wait_for_selector("body[data-state=ready]", state="attached")
            expect(page.locator("#live")).to_have_text("live")
            drawn = Image.open(BytesIO(page.screenshot()))
            few = drawn.convert("RGB").quantize(  # no colour of a line is lost
                256, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE
            )
            few.save(RESULTS / f"{name}.png", optimize=True)
            print(RESULTS / f"{name}.png")
        browser.close()


if __name__ == "__main__":
    main(sys.argv[1])

"""Every page with the data of the main job: a hundred blades, scans, CEEQ, all of the plan."""

from __future__ import annotations

from collections.abc import Iterator

import httpx
import pytest
from playwright.sync_api import Browser, expect

from core.builtin import inspection_plan
from service.bootstrap import make_science, make_store, make_worker
from service.settings import Settings
from service.worker.claiming import Role
from tests.browser.conftest import Running, sealed, serving, watching
from tests.browser.test_pages_in_browser import COLOURS, serious

PARTICLES = 100  # of a blade: pages show as much of a hundred as of ten thousand
SIZES = ((1280, "light"), (1920, "dark"))
PAGES = (
    "/", "/rotors/demo?limit=0.9", "/rotors/demo/readings", "/rotors/demo/blades/B001?limit=0.9",
    "/rotors/demo/blades/B028-2", "/rotors/demo/blades/B001/3d", "/rotors/demo/residuals",
    "/rotors/demo/diagnoses", "/models", "/models/rotor-blade", "/operations",
)  # fmt: skip
# Pairs of words in pictures that lie on one another by more than two pixels either way.
ON_ONE_ANOTHER = """() => [document, ...[...document.querySelectorAll(".pictured")].map((one) => one.shadowRoot)]
  .flatMap((root) => [...root.querySelectorAll("svg")]).flatMap((svg) => {
  const words = [...svg.querySelectorAll("text")].map((t) => [t.textContent, t.getBoundingClientRect()])
    .filter(([, box]) => box.width > 0);
  return words.flatMap(([a, one], i) => words.slice(i + 1)
    .filter(([, two]) => Math.min(one.right, two.right) - Math.max(one.left, two.left) > 2
      && Math.min(one.bottom, two.bottom) - Math.max(one.top, two.top) > 2)
    .map(([b]) => `${a} | ${b}`));
})"""  # noqa: E501


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    """The rotor of the inspection plan, every reading of it applied, and another one.

    A worker in this process takes all of it at once, where one of the service would compute a
    version of whatever had come by then.
    """
    with serving(tmp_path_factory.mktemp("demo"), workers=0) as running:
        head = stream(running.client)
        work_off(running, "all")
        sealed(running.client, head, "demo")
        yield running


def work_off(running: Running, role: Role) -> None:
    settings = Settings(database_url=running.database, seal_after_s=0.0)
    store = make_store(settings)
    try:
        make_worker(store, make_science(settings, store), settings, "test", role).drain()
    finally:
        store.close()


def stream(client: httpx.Client) -> int:
    blades = [
        {"id": name, "slot": name[1:4], "coating_lot": f"C{int(name[1:4]) % 3 + 1}"}
        for name in inspection_plan.blades()
    ]
    first, later = ([b for b in blades if b["id"].endswith("-2") == new] for new in (False, True))
    body = {"id": "demo", "model": "rotor-blade", "particles": PARTICLES, "blades": first}
    for rotor in (body, body | {"id": "other", "blades": first[:2]}):
        client.post("/v1/rotors", json=rotor).raise_for_status()
    for blade in later:  # each in the slot of the one that it replaces
        leaves = f"/v1/rotors/demo/blades/{blade['id'].removesuffix('-2')}/retirement"
        client.post(leaves).raise_for_status()
        client.post("/v1/rotors/demo/blades", json=blade).raise_for_status()
    plan = inspection_plan.load().inspections
    assert len(plan) == 306
    told = client.post("/v1/rotors/demo/inspections", json={"inspections": list(plan)})
    return int(told.raise_for_status().json()["head_seq"])


@pytest.fixture(scope="module")
def diagnosed(demo: Running) -> str:
    """The page of a diagnosis of all of it, worked off by a worker in this process."""
    made = demo.client.post("/v1/rotors/demo/diagnoses", json={}).raise_for_status().json()
    work_off(demo, "diagnose")
    path = f"/rotors/demo/diagnoses/{made['diagnosis']['id']}"
    told = demo.client.get(f"/v1{path}").json()
    assert told["status"] == "done", told
    return path


@pytest.mark.parametrize(("width", "scheme"), SIZES)
def test_every_page_stands_with_the_main_job_s_data(
    browser: Browser, demo: Running, diagnosed: str, width: int, scheme: str
) -> None:
    for seen in watching(browser, demo):
        page = seen.page
        page.set_viewport_size({"width": width, "height": 900})
        page.emulate_media(color_scheme="dark" if scheme == "dark" else "light")
        for path in (*PAGES, diagnosed):
            seen.open(path)
            expect(page.locator("#notice .bad")).to_have_count(0)
            assert page.evaluate(ON_ONE_ANOTHER) == [], path
            assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), path
            assert serious(page) == [], path
        assert (seen.errors, seen.outside) == ([], [])


def test_a_diagnosis_page_shows_the_report_s_pictures(
    browser: Browser, demo: Running, diagnosed: str
) -> None:
    """Of 300 readings before and after; each picture as the report has it."""
    report = demo.client.get(f"/v1{diagnosed}/report").raise_for_status().text
    for seen in watching(browser, demo):
        page = seen.open(diagnosed)
        drawn = page.locator(".pictured figure svg")
        expect(drawn.first).to_be_visible()
        assert drawn.count() == report.count("<figure>") > 3
        cells = page.locator(".pictured rect.cell")
        assert cells.count() == report.count('class="cell ') > 300
        colours = page.evaluate(  # in one turn: the page may draw its pictures anew in the next
            "() => [...new Set([...document.querySelectorAll('.pictured')]"
            ".flatMap((one) => [...one.shadowRoot.querySelectorAll('rect.cell')])"
            ".map((cell) => getComputedStyle(cell).fill))]"
        )
        assert len(colours) > 3, f"the report's own sheet does not hold: {colours}"
        assert (seen.errors, seen.outside) == ([], [])


def test_the_plan_s_scan_and_band_are_shown(browser: Browser, demo: Running) -> None:
    for seen in watching(browser, demo):
        page = seen.open("/rotors/demo/blades/B001/3d")
        share, colours = page.locator(".space canvas").evaluate(COLOURS)
        assert share > 0.05
        assert colours > 20
        expect(page.locator("main")).to_contain_text("B001-d3")
        seen.open("/rotors/demo")
        expect(page.locator(".ring a")).to_have_count(100)
        assert serious(page) == []


def test_words_on_one_another_are_seen(browser: Browser, demo: Running) -> None:
    for seen in watching(browser, demo):
        page = seen.open("/rotors/demo")
        seen_together = page.evaluate(  # in one turn: the page may draw its ring anew in the next
            "() => { document.querySelector('svg.ring').insertAdjacentHTML('beforeend',"
            '\'<text x="200" y="200">one</text><text x="202" y="202">two</text>\');'
            f" return ({ON_ONE_ANOTHER})() }}"
        )
        assert "one | two" in seen_together

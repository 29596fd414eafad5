"""From the question to the model and out of it again, by the buttons of the diagnosis' page."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import httpx
import numpy as np
import pytest
from playwright.sync_api import Browser, Locator, Page, expect

from core.observation import Inspection
from service.bootstrap import make_worker
from service.fake import FakeScience
from service.handlers.inspections import Item, post_inspections
from service.handlers.models import register_builtins
from service.handlers.rotors import create_rotor
from service.handlers.transfer_in import import_rotor
from service.handlers.transfer_out import export_rotor
from service.ports import BladeRecord, Diagnose, Json, ModelCard
from service.settings import Settings
from service.store.engine import open_engine
from service.store.migrate import migrate
from service.store.unit_of_work import SqlStore
from service.worker.loop import Worker
from tests.browser.conftest import Running, Watched, watching
from tests.browser.test_pages_in_browser import serious
from tests.service.adopting import Doubtful, Lots, Offsets
from tests.service.conftest import RunningServer, served
from tests.service.test_adoption import NAME, OFF, of_a_lot, visits
from tests.service.test_joining import LOTS, read
from tests.service.told import told


@dataclass(frozen=True)
class Twin:
    """A service whose twin can name an effect; its workers run when the test lets them."""

    client: httpx.Client
    store: SqlStore
    worker: Worker
    diagnoser: Worker

    def rotor(self) -> dict[str, Any]:
        told: dict[str, Any] = self.client.get("/v1/rotors/r1").json()
        return told

    def digest(self) -> str:
        return str(self.rotor()["posterior"]["state_digest"])


def reading(name: str, *, value: float, **given: Any) -> Inspection:
    return Inspection(id=name, quantity="elongation", values=np.array([value]), **given)


@contextmanager
def running(
    folder: Path,
    science: FakeScience,
    blades: list[BladeRecord],
    readings: list[Inspection],
    diagnose: Diagnose = "never",
) -> Iterator[Twin]:
    settings = Settings(
        database_url=f"sqlite:///{folder / 'x.db'}", science="fake", seal_after_s=0.0
    )
    store, server = SqlStore(open_engine(settings.database_url)), RunningServer()
    migrate(store.engine)
    register_builtins(store, science)
    create_rotor(store, "r1", "rotor-blade", blades, 64, 7, diagnose=diagnose)
    post_inspections(store, "r1", [Item("", one) for one in readings])
    worker = make_worker(store, science, settings, "worker-1")
    diagnoser = make_worker(store, science, settings, "diagnoser-1", "diagnose")
    worker.drain()
    with served(store, science, settings, server) as client:
        yield Twin(client, store, worker, diagnoser)
    server.stop()
    store.close()


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[Twin]:
    blades = [BladeRecord(f"B{i}") for i in (1, 2, 3)]
    with running(tmp_path, Offsets(), blades, visits(reading, OFF)) as twin:
        yield twin


class Nameless(Offsets):
    """What it finds has no name; a discrepancy is borne out."""

    ADDS: ClassVar[Json] = {
        "quantities": {"elongation": {"discrepancy": {"kind": "gp", "sd": 0.1, "length_h": 2e4}}}
    }

    def named(self, card: ModelCard, campaign: str, size: float) -> Json:
        wide = {"quantity": "elongation", "discrepancy": {}, "gained_nat": 9.0, "borne_out": True}
        wide |= {"time_h": 5e4, "share": 0.4, "sd": {"before": 0.1, "after": 0.2}}
        after = self.vary(card, self.ADDS).digest
        models = {"before": card.digest, "after": after}
        return {"verdict": "unattributed", "widened": wide, "adds": self.ADDS, "models": models}


@pytest.fixture
def nameless(tmp_path: Path) -> Iterator[Twin]:
    blades = [BladeRecord(f"B{i}") for i in (1, 2, 3)]
    with running(tmp_path, Nameless(), blades, visits(reading, OFF)) as twin:
        yield twin


@pytest.fixture
def lots(tmp_path: Path) -> Iterator[Twin]:
    """Of two lots of two blades, one reads longer."""
    blades = [BladeRecord(name, lot=lot) for name, lot in LOTS.items()]
    readings = [one for name, lot in LOTS.items() for one in read(reading, name, lot)]
    with running(tmp_path, Lots(), blades, readings) as twin:
        yield twin


@pytest.fixture
def asking(tmp_path: Path, browser: Browser) -> Iterator[tuple[Watched, Twin]]:
    """Its residuals ask for diagnoses by themselves."""
    blades = [BladeRecord(f"B{i}") for i in (1, 2, 3)]
    off = visits(reading, {"c2": 0.3})
    with running(tmp_path, Offsets(), blades, off, "alarm") as twin:
        for seen in watched(browser, twin):
            yield seen, twin


@pytest.fixture
def seen(browser: Browser, twin: Twin) -> Iterator[Watched]:
    yield from watched(browser, twin)


@pytest.fixture
def seen_lots(browser: Browser, lots: Twin) -> Iterator[Watched]:
    yield from watched(browser, lots)


def watched(browser: Browser, twin: Twin) -> Iterator[Watched]:
    yield from watching(browser, Running(str(twin.client.base_url).rstrip("/"), "", twin.client))


def said(page: Page) -> Locator:
    """Where the page tells what became of a button."""
    return page.locator("main").get_by_role("status")


def press(page: Page, button: str, *, sure: bool) -> None:
    """A button that asks whether one is sure."""
    page.once("dialog", lambda asked: asked.accept() if sure else asked.dismiss())
    page.get_by_role("button", name=button).click()


def test_what_a_diagnosis_named_is_adopted_and_backed_out_by_its_page(
    seen: Watched, twin: Twin
) -> None:
    page = seen.open("/rotors/r1/diagnoses")
    page.get_by_role("button", name="Look for what the model lacks").click()
    page.wait_for_url("**/diagnoses/*")
    expect(page.locator("#states")).to_contain_text("queued")
    page.evaluate("window.same = true")
    twin.diagnoser.drain()
    expect(page.get_by_role("button", name="Adopt into the model")).to_be_visible()
    expect(page.locator("main")).to_contain_text(NAME)
    standing = page.locator("section", has=page.get_by_role("heading", name="In the model"))
    expect(standing).to_contain_text("Not in the model.")
    expect(page.get_by_role("button", name="Back out")).to_have_count(0)
    before = twin.digest()

    press(page, "Adopt into the model", sure=False)
    page.wait_for_timeout(200)
    assert twin.rotor()["head_seq"] == 12, "negative control: nothing without a yes"

    press(page, "Adopt into the model", sure=True)
    expect(said(page)).to_contain_text("Adopt: done.")
    expect(standing).to_contain_text("Adopted. The next version will have the effect")
    expect(page.get_by_role("button", name="Adopt into the model")).to_have_count(0)
    assert twin.rotor()["head_seq"] == 13
    twin.worker.drain()
    expect(standing).to_contain_text("Version 2 of the posterior has the effect")
    assert [one["name"] for one in twin.rotor()["effects"]] == [NAME]
    assert twin.digest() != before
    assert serious(page) == []
    other = page.context.new_page()
    other.goto(f"{seen.service.url}/rotors/r1")
    stands = other.locator("dl", has=other.get_by_text("Adopted"))
    expect(stands).to_contain_text(re.compile(re.escape(NAME) + ", .* ago"))
    expect(stands).not_to_contain_text("by the rotor itself")
    other.goto(f"{seen.service.url}/rotors/r1/blades/B1")
    versions = other.get_by_role("region", name="Versions").locator("tbody tr")
    expect(versions.first).to_contain_text(f"1 entry; adopted: {NAME}")
    other.close()

    press(page, "Back out", sure=True)
    expect(said(page)).to_contain_text("Back out: done.")
    expect(standing).to_contain_text("Backed out. The next version will have the network before")
    twin.worker.drain()
    expect(standing).to_contain_text("Version 3 of the posterior has the network before it")
    rows = standing.locator("tbody tr")
    expect(rows).to_have_count(2)
    expect(rows.first).to_contain_text("adopted")
    expect(rows.last).to_contain_text("backed out")
    assert twin.digest() == before, "the bit-identical state of before"
    expect(page.get_by_role("button", name="Adopt into the model")).to_be_visible()
    assert page.evaluate("window.same") is True, "never reloaded"
    assert (seen.errors, seen.outside) == ([], [])


def test_what_an_imported_rotor_brought_of_a_diagnosis_is_shown_and_backed_out(
    seen: Watched, twin: Twin, tmp_path: Path
) -> None:
    """The diagnosis stayed where it was made; its effect is linked to from the rotor's page."""
    asked = twin.client.post("/v1/rotors/r1/diagnoses", json={}).raise_for_status()
    found = asked.json()["diagnosis"]["id"]
    twin.diagnoser.drain()
    twin.client.post(f"/v1/rotors/r1/diagnoses/{found}/adoption").raise_for_status()
    twin.worker.drain()
    export_rotor(twin.store, "r1", tmp_path / "r1.zip", "test")
    import_rotor(twin.store, Offsets(), tmp_path / "r1.zip", "copy")
    twin.worker.drain()
    page = seen.open(f"/rotors/copy/diagnoses/{found}")
    expect(page.locator("#states")).to_contain_text("not here")
    expect(page.locator("#notice .warn")).to_contain_text("did not travel with its rotor")
    effects = page.get_by_role("region", name="Effects")
    expect(effects).to_contain_text(NAME)
    expect(effects).to_contain_text("0.100 ± 0.010 mm")
    press(page, "Back out", sure=True)
    expect(said(page)).to_contain_text("Back out: done.")
    expect(page.locator("main")).to_contain_text("Backed out.")
    expect(page.get_by_role("button", name="Back out")).to_have_count(0)
    assert serious(page) == []
    assert seen.outside == []
    assert all("404" in one for one in seen.errors), "nothing but what is not there"
    page = seen.open("/rotors/copy/diagnoses/never", state="failed")
    expect(page.locator("#notice .warn")).to_contain_text("Not found")


def test_a_rotor_s_page_tells_that_it_adopted_by_itself(seen: Watched, twin: Twin) -> None:
    told = twin.client.post("/v1/rotors/r1/policy", json={"adopt": "effect"})
    told.raise_for_status()
    twin.client.post("/v1/rotors/r1/diagnoses", json={}).raise_for_status()
    twin.diagnoser.drain()
    twin.worker.drain()
    page = seen.open("/rotors/r1")
    stands = page.locator("dl", has=page.get_by_text("Adopted"))
    expect(stands).to_contain_text(re.compile(re.escape(NAME) + ", .* ago, by the rotor itself"))
    assert (seen.errors, seen.outside) == ([], [])


def test_a_discrepancy_that_is_borne_out_is_adopted_and_backed_out_by_its_page(
    browser: Browser, nameless: Twin
) -> None:
    """The report says that it can be; the page had no button for it, not even to back it out."""
    made = nameless.client.post("/v1/rotors/r1/diagnoses").json()["diagnosis"]["id"]
    nameless.diagnoser.drain()
    for seen in watched(browser, nameless):
        page = seen.open(f"/rotors/r1/diagnoses/{made}")
        standing = page.locator("section", has=page.get_by_role("heading", name="In the model"))
        expect(standing).to_contain_text("Not in the model.")
        press(page, "Adopt into the model", sure=True)
        expect(standing).to_contain_text("Adopted. The next version will have the discrepancy")
        nameless.worker.drain()
        assert [e["kind"] for e in nameless.rotor()["effects"]] == ["unnamed"]
        press(page, "Back out", sure=True)
        expect(standing).to_contain_text("Backed out.")
        assert nameless.rotor()["head_seq"] == 14
        assert serious(page) == []
        assert (seen.errors, seen.outside) == ([], [])


class Splitting(Doubtful):
    """It tells what would tell them apart, too."""

    def named(self, card: ModelCard, campaign: str, size: float) -> Json:
        separating = told("not separable")["separating"]
        return super().named(card, campaign, size) | {"separating": separating}


def test_one_of_what_is_not_told_apart_is_chosen_with_a_reason_and_backed_out(
    browser: Browser, tmp_path: Path
) -> None:
    blades = [BladeRecord(f"B{i}") for i in (1, 2, 3)]
    with running(tmp_path, Splitting(), blades, visits(reading, OFF)) as twin:
        made = twin.client.post("/v1/rotors/r1/diagnoses").json()["diagnosis"]["id"]
        twin.diagnoser.drain()
        for seen in watched(browser, twin):
            page = seen.open(f"/rotors/r1/diagnoses/{made}")
            known = page.locator("section", has=page.get_by_role("heading", name="Known from"))
            expect(known.locator("tbody tr")).to_have_count(2)
            expect(known.locator("tbody tr").last).to_contain_text("campaign c3), constant")
            expect(page.get_by_role("button", name="Adopt into the model")).to_have_count(0)
            apart = page.locator("section", has=page.get_by_role("heading", name="that would tell"))
            expect(apart.locator("p.told")).to_have_count(2)
            expect(apart.locator("p.told").first).to_contain_text("Best single reading: permanent")
            expect(apart.locator("p.told").last).to_contain_text("all blades at once: 3-D scan")
            assert serious(page) == []
            for answer in ("", "   ", None):
                page.once("dialog", lambda d, a=answer: d.dismiss() if a is None else d.accept(a))
                page.get_by_role("button", name="Adopt 2").click()
            page.wait_for_timeout(200)
            assert twin.rotor()["head_seq"] == 12, "negative control: nothing without a reason"
            page.once("dialog", lambda asked: asked.accept("the scanner's log"))
            page.get_by_role("button", name="Adopt 2").click()
            standing = page.locator("section", has=page.get_by_role("heading", name="In the model"))
            expect(standing).to_contain_text("alternative 2: the scanner's log")
            expect(known).to_have_count(0)
            twin.worker.drain()
            (effect,) = twin.rotor()["effects"]
            assert effect["chosen"] == {"alternative": 2, "because": "the scanner's log"}
            other = page.context.new_page()
            other.goto(f"{seen.service.url}/rotors/r1")
            stands = other.locator("dl", has=other.get_by_text("Adopted"))
            expect(stands).to_contain_text("chosen: the scanner's log")
            other.close()
            press(page, "Back out", sure=True)
            expect(standing).to_contain_text("Backed out.")
            expect(known.locator("tbody tr")).to_have_count(2)
            assert (seen.errors, seen.outside) == ([], [])


def test_the_report_is_saved_and_a_refusal_is_told_where_the_button_is(
    seen: Watched, twin: Twin, tmp_path: Path
) -> None:
    made = twin.client.post("/v1/rotors/r1/diagnoses", json={"compare": False}).json()
    name = made["diagnosis"]["id"]
    twin.diagnoser.drain()
    page = seen.open(f"/rotors/r1/diagnoses/{name}")
    with page.expect_download() as saved:
        page.get_by_role("button", name="Save the report").click()
    file = tmp_path / saved.value.suggested_filename
    saved.value.save_as(file)
    assert file.name == f"diagnosis-r1-{name}.html"
    report = twin.client.get(f"/v1/rotors/r1/diagnoses/{name}/report")
    assert file.read_bytes() == report.content

    twin.client.post("/v1/rotors/r1/inspections/B1-c1/retraction").raise_for_status()
    press(page, "Adopt into the model", sure=True)
    expect(said(page)).to_contain_text("Adopt: ")
    expect(said(page)).not_to_contain_text("done")
    refused = twin.client.post(f"/v1/rotors/r1/diagnoses/{name}/adoption").json()
    expect(said(page)).to_contain_text(refused["detail"][:40])
    expect(page.get_by_role("button", name="Adopt into the model")).to_be_visible()
    refusal = "Failed to load resource: the server responded with a status of 409 (Conflict)"
    assert seen.errors == [refusal], "the browser's own line, and nothing else"


def test_pages_name_a_blade_that_joined_after_an_effect_of_its_lot(
    seen: Watched, twin: Twin
) -> None:
    """On the page of the rotor and on its own; on no page before it joined."""
    asked = twin.client.post("/v1/rotors/r1/diagnoses").json()["diagnosis"]["id"]
    twin.diagnoser.drain()
    name = of_a_lot(twin.store, asked)
    twin.client.post(f"/v1/rotors/r1/diagnoses/{asked}/adoption").raise_for_status()
    twin.worker.drain()
    warning = f"B9 joined after “{name}” was adopted, which concerns it."
    page = seen.open("/rotors/r1")
    expect(page.locator("main")).to_contain_text("B3")
    expect(page.locator("main")).not_to_contain_text("joined after")
    twin.client.post("/v1/rotors/r1/blades", json={"id": "B9", "lot": "L1"}).raise_for_status()
    twin.worker.drain()
    for path in ("/rotors/r1", "/rotors/r1/blades/B9"):
        page = seen.open(path)
        expect(page.locator("main")).to_contain_text(warning)
        expect(page.locator("main")).to_contain_text("diagnose and adopt anew")


def test_pages_name_readings_behind_an_adopted_effect_that_count_no_longer(
    seen: Watched, twin: Twin
) -> None:
    """On the page of the rotor, and on that of the diagnosis; on neither before."""
    asked = twin.client.post("/v1/rotors/r1/diagnoses").json()["diagnosis"]["id"]
    twin.diagnoser.drain()
    twin.client.post(f"/v1/rotors/r1/diagnoses/{asked}/adoption").raise_for_status()
    twin.worker.drain()
    paths = ("/rotors/r1", f"/rotors/r1/diagnoses/{asked}")
    for path in paths:
        page = seen.open(path)
        expect(page.locator("main")).to_contain_text("Back out" if asked in path else "B3")
        expect(page.locator("body")).not_to_contain_text("no longer")
    twin.client.post("/v1/rotors/r1/inspections/B1-c1/retraction").raise_for_status()
    twin.worker.drain()
    for path in paths:
        page = seen.open(path)
        expect(page.locator("#notice")).to_contain_text("1 reading with which “")
        expect(page.locator("#notice")).to_contain_text("counts no longer: B1-c1.")
    assert (seen.errors, seen.outside) == ([], [])


def test_the_page_of_an_adopted_diagnosis_tells_which_blade_joined(
    seen_lots: Watched, lots: Twin
) -> None:
    """A row of its own, of what is in force; neither page warns of a blade that has the effect."""
    name = lots.client.post("/v1/rotors/r1/diagnoses").json()["diagnosis"]["id"]
    lots.diagnoser.drain()
    lots.client.post(f"/v1/rotors/r1/diagnoses/{name}/adoption").raise_for_status()
    lots.worker.drain()
    page = seen_lots.open(f"/rotors/r1/diagnoses/{name}")
    standing = page.locator("section", has=page.get_by_role("heading", name="In the model"))
    expect(standing.locator("tbody tr")).to_have_count(1)
    for blade, lot in (("B8", "L2"), ("B9", "L1")):
        body = {"id": blade, "lot": lot}
        lots.client.post("/v1/rotors/r1/blades", json=body).raise_for_status()
    lots.worker.drain()
    page = seen_lots.open(f"/rotors/r1/diagnoses/{name}")
    rows = standing.locator("tbody tr")
    expect(rows).to_have_count(2)
    expect(rows.filter(has_text="blade B9 joined")).to_have_count(1)
    expect(rows.filter(has_text="B8")).to_have_count(0)
    expect(standing).to_contain_text("has the effect")
    expect(page.get_by_role("button", name="Back out")).to_be_visible()
    assert serious(page) == []
    for path in ("/rotors/r1", "/rotors/r1/blades/B9"):
        page = seen_lots.open(path)
        expect(page.locator("main")).to_contain_text("B9")
        expect(page.locator("main")).not_to_contain_text("joined after")
    assert (seen_lots.errors, seen_lots.outside) == ([], [])


def test_a_diagnosis_that_the_residuals_asked_for_says_what_alarmed(
    asking: tuple[Watched, Twin],
) -> None:
    seen, twin = asking
    page = seen.open("/rotors/r1/diagnoses")
    expect(page.get_by_label("It asks")).to_have_value("alarm")
    expect(page.locator("main")).to_contain_text("None was asked for yet.")
    twin.diagnoser.drain()
    (one,) = twin.client.get("/v1/rotors/r1/diagnoses").json()["items"]
    row = page.get_by_role("table").get_by_role("row", name=NAME)
    expect(row).to_contain_text("residuals")
    expect(row).not_to_contain_text("adopted")
    assert not serious(page)
    where = f"/v1/rotors/r1/diagnoses/{one['id']}/adoption"
    twin.client.post(where).raise_for_status()
    twin.worker.drain()
    expect(row).to_contain_text("adopted")
    twin.client.delete(where).raise_for_status()
    twin.worker.drain()
    expect(row).not_to_contain_text("adopted")
    page = seen.open(f"/rotors/r1/diagnoses/{one['id']}")
    expect(page.locator("main")).to_contain_text("tests alarm in version 1")
    expect(page.locator("main")).to_contain_text("campaign c2 (mean)")
    assert not serious(page)


def test_what_a_rotor_does_by_itself_is_decided_on_its_page(
    asking: tuple[Watched, Twin],
) -> None:
    seen, twin = asking
    page = seen.open("/rotors/r1/diagnoses")
    asks, adopts = page.get_by_label("It asks"), page.get_by_label("and adopts")
    decide = page.get_by_role("button", name="Decide")
    expect(adopts).to_have_value("never")
    expect(decide).to_be_disabled()
    adopts.select_option("effect")
    asks.select_option("readings")
    expect(decide).to_be_enabled()
    page.wait_for_timeout(3500)  # the page looks again: a choice that is being made stays
    expect(adopts).to_have_value("effect")
    decide.click()
    expect(page.get_by_role("status").filter(has_text="Decided.")).to_be_visible()
    expect(decide).to_be_disabled()
    assert (twin.rotor()["diagnose"], twin.rotor()["adopt"]) == ("readings", "effect")
    twin.client.post("/v1/rotors/r1/policy", json={"adopt": "never"})
    expect(adopts).to_have_value("never")
    assert not serious(page)
    assert (seen.errors, seen.outside) == ([], [])


def test_amplitudes_are_shown_with_the_unit_and_the_bounds_that_were_adopted(
    seen: Watched,
) -> None:
    """Of what is added to an input or a reading the unit is theirs, of a share it is none."""

    def normal(low: float, high: float, mean: float, sd: float) -> Json:
        return {"kind": "normal", "low": low, "high": high, "mean": mean, "sd": sd}

    names = {"fouling": (0.0, 40.0), "wear": (0.0, 0.8), "off": (-0.2, 0.2)}
    effects = {
        "parameters": [
            *({"name": n, "level": "shared", "unit": "1", "prior": normal(*ends, 0.0, 0.1)}
              for n, ends in names.items()),
            {"name": "leak", "level": "shared", "unit": "kg/s", "prior": normal(0, 3, 0, 1)},
        ],
        "drifts": [{"name": "fouling", "input": "gas", "how": "plus"},
                   {"name": "wear", "input": "gas", "how": "times"}],
        "biases": [{"name": "off", "quantity": "drop", "how": "plus"}],
    }  # fmt: skip
    asleep = {"name": "leak", "level": "dormant", "unit": "kg/s", "prior": normal(-3, 3, 0, 1)}
    gas = {"name": "gas", "level": "shared", "unit": "K", "prior": normal(900, 1100, 1000, 50)}
    network = {"parameters": [gas, asleep], "quantities": [{"name": "drop", "unit": "kPa"}]}
    page = seen.open("/rotors/r1/blades/B1")
    table = page.evaluate(
        """async ([network, effects]) => {
            const { withEffects } = await import("/assets/effects.js");
            const { marginals } = await import("/assets/corner.js");
            const names = ["gas", "fouling", "wear", "off", "leak"];
            const values = [[990, 1, 0.1, 0, 1], [1010, 2, 0.2, 0.1, 2]];
            const place = document.createElement("div");
            marginals(place, { names, values, of: 2 }, withEffects(network, effects));
            const rows = [...place.querySelectorAll("tbody tr")];
            return rows.map((row) => [...row.cells].slice(0, 4).map((cell) => cell.textContent));
        }""",
        [network, effects],
    )
    assert [(name, level, unit) for name, level, unit, _ in table] == [
        ("gas", "shared", "K"),
        ("fouling", "shared, adopted", "K"),
        ("wear", "shared, adopted", "1"),
        ("off", "shared, adopted", "kPa"),
        ("leak", "shared, adopted", "kg/s"),
    ]
    assert table[-1][-1] == "normal 0 ± 1.00, 0 … 3.00", "cut as it was adopted"
    assert (seen.errors, seen.outside) == ([], [])

"""The pages as people meet them: a real rotor, a real browser."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, Route, expect

from service.report.words import percent
from tests.browser.conftest import (
    HOSTILE,
    PATIENCE_MS,
    Running,
    Watched,
    comes,
    ended,
    reading,
    scan,
    sealed,
)
from tests.service.told import told

AXE = (Path(__file__).parent / "vendor" / "axe.min.js").read_text()
PATHS = (
    "/",
    "/rotors/r1",
    "/rotors/r1/readings",
    "/rotors/r1/blades/B1?limit=0.4",
    "/rotors/r1/blades/B2/3d",
    "/rotors/r1/residuals",
    "/rotors/r1/diagnoses",
    "/rotors/r1/diagnoses/{d}",
    "/models",
    "/models/rotor-blade",
    "/operations",
)
COLOURS = """canvas => {
  const copy = document.createElement("canvas");
  copy.width = canvas.width; copy.height = canvas.height;
  const ctx = copy.getContext("2d");
  ctx.drawImage(canvas, 0, 0);
  const {data} = ctx.getImageData(0, 0, copy.width, copy.height);
  const seen = new Set();
  let coloured = 0;
  for (let i = 0; i < data.length; i += 4) {
    if (data[i + 3] < 250) continue;
    const [r, g, b] = [data[i], data[i + 1], data[i + 2]];
    if (Math.max(r, g, b) - Math.min(r, g, b) < 25) continue;
    coloured += 1;
    seen.add((r >> 4) * 256 + (g >> 4) * 16 + (b >> 4));
  }
  return [coloured / (data.length / 4), seen.size];
}"""


def serious(page: Page, *rules: str) -> list[str]:
    """What axe-core finds that keeps people from using a page; `rules`: by these alone."""
    page.evaluate(AXE + "; undefined")
    asked: dict[str, Any] = {"resultTypes": ["violations"]}
    asked |= {"runOnly": list(rules)} if rules else {}
    found: dict[str, Any] = page.evaluate("asked => axe.run(asked)", asked)
    grave = [one for one in found["violations"] if one["impact"] in ("serious", "critical")]
    return [f"{one['id']}: {node['html'][:150]}" for one in grave for node in one["nodes"]]


@pytest.mark.parametrize("path", PATHS)
def test_a_page_stands_without_error_or_outside_request_and_everybody_can_use_it(
    watched: Watched, path: str, diagnosis: str
) -> None:
    page = watched.open(path.replace("{d}", diagnosis))
    expect(page.locator("h1")).not_to_be_empty()
    expect(page.locator("#notice .bad")).to_have_count(0)
    assert serious(page) == []
    page.emulate_media(color_scheme="dark")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(18, 23, 28)"
    assert serious(page, "color-contrast") == []
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), "no overflow"
    assert (watched.errors, watched.outside) == ([], [])


def test_what_a_diagnosis_compared_is_told_in_tables(watched: Watched, diagnosis: str) -> None:
    """The forecast, the readings held out and the halves stood there as JSON."""
    page = watched.open(f"/rotors/r1/diagnoses/{diagnosis}")
    compared = page.get_by_role("region", name="Before and after")
    row = compared.get_by_role("row", name="forecast")
    expect(row).to_contain_text("± sd of a single blade [mm]")
    expect(row).to_contain_text("0.410 ± 0.020")
    expect(row).to_contain_text("0.360 ± 0.015")
    expect(page.locator("details", has_text="readings of elongation")).to_contain_text("1-3, 2-3")
    halves = page.get_by_role("region", name="Does it hold between halves")
    page.get_by_text("Does it hold between halves").first.click()
    expect(halves.get_by_role("row", name="early and late")).to_contain_text("1.00 and 1.20")
    expect(page.locator("main pre")).to_have_count(0)


def test_after_a_lack_without_a_name_is_said_to_be_of_the_discrepancy(watched: Watched) -> None:
    """Beside it stand effects that were calibrated and not claimed: of them it was read."""
    wide = {"borne_out": True, "quantity": "elongation", "time_h": 50_000.0, "share": 0.4}
    wide |= {"discrepancy": {}, "gained_nat": 9.0, "sd": {"before": 0.007, "after": 0.0378}}
    of_effect = told("effect")
    both = {name: of_effect[name] for name in ("effects", "gained_nat", "before_after")}
    found = told("unattributed", widened=wide, **both)
    words = "After is the model with a discrepancy that names no cause"
    page = watched.open(f"/rotors/r1/diagnoses/{ended(watched.service, found)}")
    expect(page.locator("main")).to_contain_text(words)
    expect(page.locator("dl", has_text="Gain in evidence")).to_contain_text("not claimed")
    page = watched.open(f"/rotors/r1/diagnoses/{ended(watched.service, of_effect)}")
    expect(page.get_by_role("region", name="Before and after")).to_be_visible()
    expect(page.locator("main")).not_to_contain_text(words)
    expect(page.locator("dl", has_text="Gain in evidence")).not_to_contain_text("not claimed")


def test_a_diagnosis_that_found_nothing_tells_what_it_would_have_found(watched: Watched) -> None:
    page = watched.open(f"/rotors/r1/diagnoses/{ended(watched.service, told('adequate'))}")
    table = page.get_by_role("region", name="What would have been noticed")
    wear, step, offset = (
        table.get_by_role("row", name=name) for name in ("wear", "firing", "camp")
    )
    expect(wear).to_contain_text("one coating lot")
    expect(wear).to_contain_text("0.061 (C2, early)")
    expect(step).to_contain_text("–")
    expect(offset).to_contain_text("0.012\u00a0mm")
    assert serious(page) == []
    assert (watched.errors, watched.outside) == ([], [])


@pytest.mark.parametrize("path", PATHS)
def test_a_page_fits_a_telephone(watched: Watched, path: str, diagnosis: str) -> None:
    """What is wider than 400 points is scrolled where it stands, and the page is not."""
    watched.page.set_viewport_size({"width": 400, "height": 800})
    page = watched.open(path.replace("{d}", diagnosis))
    expect(page.get_by_role("button", name="Key")).to_be_in_viewport(ratio=1)
    assert page.evaluate("document.documentElement.scrollWidth") == 400
    spilt = page.evaluate(
        """() => [...document.querySelectorAll(".panel")]
          .filter((one) => one.scrollWidth > one.clientWidth + 1).map((one) => one.textContent)"""
    )
    assert spilt == []


def test_a_field_on_the_page_of_the_rotor_is_told_at_its_node(watched: Watched) -> None:
    for quantity, where in (
        ("deformation", "deformation, z (radius), at node 5440 (tip) at 50,000 h"),
        ("ceeq", "ceeq at node 2840 (critical) at 50,000 h"),
        ("elongation", "elongation at 50,000 h"),
    ):
        page = watched.open(f"/rotors/r1?quantity={quantity}")
        table = page.get_by_role("region", name="Blades").locator("caption")
        expect(table).to_contain_text(f"Predicted {where} of each blade's own operation;")
        expect(page.get_by_role("button", name="Posted last, at")).to_be_visible()


def test_parameters_that_are_one_value_are_told_as_such(watched: Watched) -> None:
    """Of a blade that contradicts: rounding is no spread, and correlates with nothing."""
    told = watched.open("/models").evaluate(
        """async () => {
          const [{corner, marginals}, {withSd}] =
            await Promise.all(["corner", "format"].map((one) => import(`/assets/${one}.js`)));
          const values = Array.from({length: 1000}, (_, i) => [2 / 3, 0.1 + 1e-3, i, 2 * i]);
          const draws = {names: ["a", "b", "c", "d"], values, of: 1000};
          const [pairs, table] = [document.createElement("div"), document.createElement("div")];
          corner(pairs, draws);
          marginals(table, draws, {parameters: [], quantities: []});
          const rows = [...pairs.querySelectorAll("tbody tr")].map((one) => one.textContent);
          return [rows, table.querySelector("tbody tr").textContent, withSd(2 / 3, 0.1)];
        }"""
    )
    assert told[0] == ["a––––", "b––––", "c––1.001.00", "d––1.001.00"]
    assert "0.667 ± 0" in told[1]
    assert told[2] == "0.67 ± 0.10"
    assert watched.errors == []


def test_errors_of_a_model_have_their_units(watched: Watched) -> None:
    rows = watched.open("/models/rotor-blade").get_by_role("region", name="Errors").locator("tr")
    told = [one.inner_text().replace("\u00a0", " ").split("\t") for one in rows.all()]
    units = {row[0]: row[4].split()[-1] for row in told if row[1].endswith("rmse")}
    assert units["elongation"] == units["deformation"] == "mm"
    assert units["mises"] == "MPa"


def test_what_is_wrong_with_a_page_is_seen(watched: Watched) -> None:
    """Negative controls: an error, a request to elsewhere, a picture that says nothing."""
    page = watched.open("/models")
    page.evaluate(
        """() => {
          const broken = document.createElement("img");
          broken.src = "http://192.0.2.1/x.png";
          document.body.append(broken);
          console.error("said");
        }"""
    )
    assert comes(page, lambda: any("said" in one for one in watched.errors))
    assert any("image-alt" in one for one in serious(page))


def test_an_inspection_that_is_posted_appears_without_reload(
    watched: Watched, service: Running
) -> None:
    page = watched.open("/rotors/r1/blades/B3")
    expect(page.locator("#live")).to_have_text("live")
    page.evaluate("window.same = true")
    rows = page.get_by_role("region", name="Readings").locator("tbody tr")
    expect(rows).to_have_count(1)
    name = f"new-{time.time_ns()}"
    service.client.post("/v1/rotors/r1/inspections", json=reading(name, "B3", 24000, 0.31))
    expect(rows).to_have_count(2)
    expect(rows.nth(1)).to_contain_text(name)
    assert page.evaluate("window.same") is True
    assert watched.errors == []


def test_a_page_that_is_drawn_again_stays_as_it_was_left(
    watched: Watched, service: Running
) -> None:
    """A part that was opened stays open and the keyboard where it was: news come at any time."""
    page = watched.open("/rotors/r1/blades/B2")
    expect(page.locator("#live")).to_have_text("live")
    table = page.get_by_role("region", name="Prediction as a table")
    page.get_by_text("Prediction as a table").click()
    table.evaluate("one => { one.old = true; }")
    head = page.get_by_role("region", name="Readings").get_by_role("button").first
    head.focus()
    text = head.text_content()
    rows = page.get_by_role("region", name="Readings").locator("tbody tr")
    before = rows.count()
    name = f"late-{time.time_ns()}"
    service.client.post("/v1/rotors/r1/inspections", json=reading(name, "B2", 20000, 0.25))
    expect(rows).to_have_count(before + 1)
    page.wait_for_function(
        "label => !document.querySelector(`[aria-label='${label}']`).old",
        arg="Prediction as a table",
    )
    expect(table).to_be_visible()
    expect(head).to_be_focused()
    assert page.evaluate("document.activeElement.textContent") == text
    assert watched.errors == []


SCROLLED = """async () => {
  const source = document.querySelector("script[type=module]").src;
  const { aside, h, scroll, show } = await import(source.replace(/[a-z]+[.]js/, "dom.js"));
  const place = document.body.appendChild(h("div"));
  const long = () => scroll("Long", Array.from({ length: 200 }, (_, i) => h("p", {}, String(i))));
  show(place, aside("more", long()));
  const old = place.querySelector(".scroll");
  place.querySelector("details").open = true;
  old.scrollTop = 120;
  show(place, aside("less"), aside("more", long()));
  const [less, more] = place.querySelectorAll("details");
  return [old.isConnected, less.open, more.open, place.querySelector(".scroll").scrollTop];
}"""


def test_what_is_shown_again_keeps_its_place(watched: Watched) -> None:
    page = watched.open("/")
    assert page.evaluate(SCROLLED) == [False, False, True, 120]


def test_readings_are_marked_by_what_became_of_them(watched: Watched) -> None:
    page = watched.open("/rotors/r1/blades/B1")
    table = page.get_by_role("region", name="Readings")
    told = {
        "a": "counts",
        "late": "counts, late",
        "wrong": "replaced",
        "right": "counts, corrects",
        "gone": "retracted",
    }
    for name, state in told.items():
        row = table.locator("tr", has=page.get_by_text(name, exact=True)).first
        expect(row.locator(".state")).to_contain_text(state)
    legend = page.locator(".legend").first
    for kind in ("late", "correction", "replaced", "retracted"):
        expect(legend.get_by_text(kind, exact=True)).to_be_visible()


MARKED = """async (marks) => {
  const source = document.querySelector("script[type=module]").src;
  const { chart } = await import(source.replace(/[a-z]+[.]js/, "chart.js"));
  const place = document.querySelector("main").appendChild(document.createElement("div"));
  const drawn = { time: [0, 100], lines: [{ name: "mean", values: [0, 1], ink: "mean" }] };
  const plot = chart(place, { ...drawn, marks, what: "elongation", unitName: "mm", label: "x" });
  await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
  return [plot.scales.y.max, place.querySelector("canvas").toDataURL()];
}"""


def test_a_reading_that_does_not_count_is_at_the_edge_and_sets_no_scale(watched: Watched) -> None:
    """A decimal point that was corrected long ago pressed the band flat for ever."""
    page = watched.open("/")

    def drawn(*marks: tuple[str, float]) -> tuple[float, str]:
        given = [{"kind": kind, "time_h": 50, "value": value} for kind, value in marks]
        top, picture = page.evaluate(MARKED, given)
        return float(top), str(picture)

    bare, empty = drawn()
    assert drawn(("counts", 17.0))[0] > 17
    for kind in ("retracted", "replaced"):
        top, picture = drawn((kind, 17.0))
        assert top == bare
        assert picture != empty, "it is shown all the same"
        assert drawn((kind, 18.0))[1] != picture, "with its value"


def test_the_band_on_the_page_is_the_service_s(watched: Watched, service: Running) -> None:
    page = watched.open("/rotors/r1/blades/B1")
    told = service.client.get("/v1/rotors/r1/blades/B1/prediction").json()
    page.get_by_text("Prediction as a table").click()
    last = page.get_by_role("region", name="Prediction as a table").locator("tbody tr").last
    mean, sd = told["mean"][-1], told["sd"]["total"][-1]
    shown = [
        float(cell.replace("−", "-").replace(",", ""))
        for cell in last.locator("td").all_inner_texts()
    ]
    assert shown[0] == told["time_h"][-1]
    assert shown[1] == pytest.approx(mean, rel=1e-3)
    assert shown[3] == pytest.approx(sd, rel=1e-3)
    assert shown[2] < shown[3], "the blade itself is known better than its next reading"


def residual(k: int) -> dict[str, Any]:
    return {
        "inspection": f"i{k}", "blade": f"B{k % 3 + 1}", "quantity": "elongation",
        "campaign": HOSTILE if k % 2 else "c2", "instrument": None, "time_h": 8e3 * (k % 3 + 1),
        "rotor_h": 8e3 * (k % 3 + 1), "visit": k % 3 + 1, "part": 0, "y": 0.3, "mean": 0.29,
        "sd": 0.01, "z": 4.2 if k == 7 else 0.1 * k, "pit": 0.5,
    }  # fmt: skip


def test_each_residual_is_a_point_and_each_test_a_row(watched: Watched) -> None:
    """Two pages of residuals, as a process of the role diagnose would have left them."""
    test = {"grouping": "campaign", "value": "c2", "statistic": "mean", "count": 6, "score": 3.8}
    tests = [test | {"p": p, "p_family": min(1.0, 20 * p), "alarm": p < 0.002} for p in (0.4, 1e-3)]
    facts = {
        "rotor": "r1", "as_of": {"version": 2, "computed_at": "2031-05-04T10:00:00Z"},
        "pending": False, "error": None, "tests": tests, "alarms": 1,
        "visits": [{"visit": k, "from_h": 8e3 * k, "to_h": 8e3 * k} for k in (1, 2, 3)],
        "family_wise_error": 0.05, "draws": 999, "freedom": 6.0,
    }  # fmt: skip

    def answer(route: Route) -> None:
        first = "cursor" not in route.request.url
        items = [residual(k) for k in (range(8) if first else range(8, 12))]
        route.fulfill(json=facts | {"items": items, "next": "8" if first else None})

    watched.page.route("**/v1/rotors/r1/residuals*", answer)
    page = watched.open("/rotors/r1/residuals?by=campaign")
    expect(page.locator("svg.wide circle")).to_have_count(12)
    cells = page.locator('svg[aria-label*="by colour"] rect:has(title)')
    names = sorted({residual(k)["blade"] for k in range(12)})
    expect(cells).to_have_count(3 * len(names))
    read = {(residual(k)["blade"], residual(k)["visit"]) for k in range(12)}
    told = cells.locator("title").all_text_contents()
    assert sum("not read" not in text for text in told) == len(read)
    worst = cells.filter(has_text="z = 4.20")
    expect(worst).to_have_attribute("fill", "rgb(178, 24, 43)")
    page.get_by_label("Blades by").select_option("lot")
    expect(page.locator('svg[aria-label*="by colour"] > text', has_text=HOSTILE)).to_have_count(1)
    assert "order=lot" in page.url
    rows = page.get_by_role("region", name="Tests").locator("tbody tr")
    expect(rows).to_have_count(2)
    expect(rows.first).to_contain_text("alarm")  # the smallest p first
    said = page.get_by_role("region", name="Tests").locator("caption")
    expect(said).to_contain_text("that by chance any of them scores as high")
    expect(page.locator("ul.legend li")).to_have_text([HOSTILE, "c2"])
    page.get_by_text("The 12 largest").click()
    largest = page.get_by_role("region", name="Largest residuals").locator("tbody tr").first
    expect(largest.locator("td").last).to_have_text("4.20")
    assert serious(page) == []
    assert watched.errors == watched.outside == []


@pytest.mark.parametrize(("alarms", "said"), [(2, "2 alarms"), (0, "no alarm")])
def test_a_rotor_says_whether_its_residuals_alarm(watched: Watched, alarms: int, said: str) -> None:
    """No blade's state says it, and an engineer may look at nothing else."""
    facts = {
        "rotor": "r1", "as_of": {"version": 2, "computed_at": "2031-05-04T10:00:00Z"},
        "pending": False, "error": None, "tests": [], "alarms": alarms, "visits": [],
        "family_wise_error": 0.05, "items": [], "next": None,
    }  # fmt: skip
    watched.page.route("**/v1/rotors/r1/residuals*", lambda route: route.fulfill(json=facts))
    page = watched.open("/rotors/r1")
    told = page.locator("dl.facts a", has_text=said)
    expect(told).to_have_attribute("href", "/rotors/r1/residuals")
    expect(told.locator(".state.bad")).to_have_count(1 if alarms else 0)
    assert serious(page) == []
    assert watched.errors == watched.outside == []


def test_a_list_of_rotors_says_which_cannot_be_trusted(watched: Watched) -> None:
    def answer(route: Route) -> None:
        told = route.fetch().json()
        health = told["items"][0]["health"]
        told["items"][0]["health"] = health | {"status": "contradicted", "trusted": False}
        route.fulfill(json=told)

    watched.page.route("**/v1/rotors?*", answer)
    page = watched.open("/")
    first, *others = page.get_by_role("region", name="Rotors").locator("tbody tr").all()
    expect(first.locator(".state.bad")).to_have_text(re.compile("not trusted: contradicted"))
    for row in others:
        expect(row.locator(".state.bad")).to_have_count(0)
    assert watched.errors == watched.outside == []


def test_a_rotor_without_blades_says_so(watched: Watched) -> None:
    def answer(route: Route) -> None:
        route.fulfill(json=route.fetch().json() | {"blades": []})

    watched.page.route("**/v1/rotors/r1", answer)
    page = watched.open("/rotors/r1")
    expect(
        page.get_by_text("No blade yet: POST /v1/rotors/r1/blades lets one join.")
    ).to_be_visible()
    assert watched.errors == watched.outside == []


def test_the_blade_in_space_has_colours_and_turns_by_key(watched: Watched) -> None:
    page = watched.open("/rotors/r1/blades/B2/3d")
    canvas = page.locator(".space canvas")
    assert comes(page, lambda: canvas.evaluate(COLOURS)[0] > 0.03), "the blade fills some of it"
    page.wait_for_timeout(300)
    share, colours = canvas.evaluate(COLOURS)
    assert share > 0.03
    assert colours > 20, "and has many colours, not black or one"
    before = canvas.evaluate("c => c.toDataURL()")
    canvas.focus()
    page.keyboard.press("ArrowLeft")
    assert comes(page, lambda: canvas.evaluate("c => c.toDataURL()") != before)
    page.wait_for_timeout(300)
    emptied = canvas.evaluate(
        f"c => {{ c.getContext('webgl2').clear(16384); return ({COLOURS})(c); }}"
    )
    assert emptied[0] < 0.001, "negative control: an empty view has none"
    expect(page.get_by_text("scan", exact=True)).to_be_visible()


FILMED = """now => document.body.innerText.includes(`instant ${now} of 11, version`) && {
  legend: document.querySelector("svg.bar").getAttribute("aria-label"),
  picture: document.querySelector(".space canvas").toDataURL(),
  hour: document.querySelector("input[type=range]").value,
  said: [...document.querySelectorAll("[role=status]")].map(one => one.textContent).join(" "),
}"""  # what stands beside an instant, in one turn: the film goes on in the next


def test_the_field_is_played_over_the_hours_in_the_same_colours(watched: Watched) -> None:
    page = watched.open("/rotors/r1/blades/B2/3d")
    page.get_by_role("button", name="Play over the hours").click()
    third, ninth = (page.wait_for_function(FILMED, arg=i).json_value() for i in (3, 9))
    assert third["legend"] == ninth["legend"]
    assert third["picture"] != ninth["picture"], "another hour, another picture"
    assert (float(third["hour"]), float(ninth["hour"])) == (10_000, 40_000)
    assert "instant" not in third["said"] + ninth["said"], "three a second would be too much"
    slider = page.get_by_role("slider")
    page.get_by_role("button", name="Stop").click()
    expect(page.get_by_role("button", name="Play over the hours")).to_be_visible()
    expect(slider).to_have_value("50000")
    assert watched.errors == []


def test_news_do_not_end_the_film(watched: Watched, service: Running) -> None:
    """The film goes on in the version that it names; its end shows the newest."""
    page = watched.open("/rotors/r1/blades/B2/3d")
    expect(page.locator("#live")).to_have_text("live")
    page.get_by_role("button", name="Play over the hours").click()
    before = service.client.get("/v1/rotors/r1").json()["version"]
    expect(page.get_by_text(f"of 11, version {before}")).to_be_visible()
    with page.expect_response(lambda answer: answer.url.endswith("/v1/rotors/r1")):
        sent = reading(f"late-{time.time_ns()}", "B2", 21000, 0.26)
        head = service.client.post("/v1/rotors/r1/inspections", json=sent).json()["head_seq"]
    sealed(service.client, head)
    page.emulate_media(color_scheme="dark")  # one more reason to draw again
    page.wait_for_timeout(1000)
    expect(page.get_by_text(f"of 11, version {before}")).to_be_visible()
    expect(page.get_by_role("button", name="Stop")).to_be_visible()
    with page.expect_response(lambda answer: "/field?" in answer.url):
        page.get_by_role("button", name="Stop").click()
    expect(page.get_by_role("slider")).to_have_value("50000")
    assert watched.errors == []


def test_a_scan_s_misfit_is_shown_at_its_nodes_and_its_hour(
    watched: Watched, service: Running
) -> None:
    page = watched.open("/rotors/r1/blades/B2/3d?axis=2")
    canvas = page.locator(".space canvas")
    page.get_by_role("button", name="Show", exact=True).click()
    expect(page.get_by_role("button", name="Hide")).to_be_visible()
    expect(page.get_by_role("slider")).to_have_value("16000")
    page.wait_for_timeout(300)
    shown = canvas.evaluate("c => c.toDataURL()")
    path = "/v1/rotors/r1/blades/B2/field?quantity=deformation&time_h=16000"
    mean = service.client.get(path).json()["mean"]
    told = scan()
    off = [v[2] - mean[n][2] for n, v in zip(told["nodes"], told["values"], strict=True)]
    page.get_by_text("Misfit at each node").click()
    rows = page.get_by_role("region", name="Misfit").locator("tbody tr")
    expect(rows).to_have_count(len(off))
    cells = rows.locator("td:last-child").all_inner_texts()
    assert [float(one.replace("−", "-")) for one in cells] == pytest.approx(off, rel=0.01)
    rms = (sum(one**2 for one in off) / len(off)) ** 0.5
    words = page.get_by_text("root mean square").inner_text()
    assert float(words.split("root mean square ")[1].split()[0]) == pytest.approx(rms, rel=0.01)
    assert serious(page) == []
    page.get_by_role("button", name="Hide").click()
    expect(page.get_by_text("root mean square")).to_have_count(0)
    assert comes(page, lambda: canvas.evaluate("c => c.toDataURL()") != shown)
    assert watched.errors == []


def test_hostile_names_stay_text(watched: Watched, diagnosis: str) -> None:
    watched.page.on("dialog", lambda dialog: watched.errors.append(f"dialog {dialog.message}"))
    paths = ("/rotors/r1", "/rotors/r1/readings", f"/rotors/r1/diagnoses/{diagnosis}")
    for path in paths:
        page = watched.open(path)
        assert HOSTILE[:20] in page.locator("main").inner_text() + page.content().replace(
            "&lt;", "<"
        ), path
        assert page.locator("main img").count() == 0, path
    assert watched.errors == []


def test_a_table_is_sorted_by_keyboard(watched: Watched) -> None:
    page = watched.open("/rotors/r1")
    table = page.get_by_role("region", name="Blades")
    head = table.get_by_role("button", name="Mean")
    head.focus()
    page.keyboard.press("Enter")
    expect(head.locator("xpath=..")).to_have_attribute("aria-sort", "ascending")
    means = [float(v) for v in table.locator("tbody td:nth-child(4)").all_inner_texts()]
    assert means == sorted(means)
    page.keyboard.press("Enter")
    expect(head.locator("xpath=..")).to_have_attribute("aria-sort", "descending")
    means = [float(v) for v in table.locator("tbody td:nth-child(4)").all_inner_texts()]
    assert means == sorted(means, reverse=True)
    page.locator(".ring a").first.focus()
    page.keyboard.press("Enter")
    page.wait_for_url("**/blades/B1")


def test_a_blocked_rotor_is_shown_as_such_with_its_remedy(
    watched: Watched, service: Running
) -> None:
    values = "blocked=1, attempts=5, last_error='no particle explains it', last_error_event='a'"
    back = "blocked=0, attempts=0, last_error=NULL, last_error_event=NULL"
    with service.changed("cursor", values, back, "rotor_id='r1'"):
        page = watched.open("/rotors/r1")
        expect(page.locator("#notice .bad")).to_contain_text("Blocked after 5 attempts by entry a")
        expect(page.locator("#states")).to_contain_text("blocked")
        page = watched.open("/operations")
        row = page.get_by_role("region", name="Blocked rotors").locator("tbody tr")
        expect(row).to_contain_text("no particle explains it")
        expect(row.get_by_role("button", name="Try again")).to_be_visible()
        expect(row.get_by_role("button", name="Retract a")).to_be_visible()
    page = watched.open("/operations")
    expect(page.get_by_text("no rotor is blocked")).to_be_visible()


def test_only_what_can_be_taken_back_is_to_be_taken_back(watched: Watched) -> None:
    """A blade that joined cannot be retracted, nor a retraction."""
    page = watched.open("/rotors/r1")
    told = page.evaluate("""async () => {
      const { warningsOf } = await import("/assets/states.js");
      const blocked = (event) => ({ status: "blocked", attempts: 5, last_error: { event } });
      const of = (event) => warningsOf(blocked(event))[0].at(-1);
      return ["a", "adoption/1", "blade/B4", "retraction/a", null].map(of);
    }""")
    assert [("retract or correct the entry" in one) for one in told] == [
        True,
        False,
        False,
        False,
        True,
    ]
    assert "back out what was adopted last" in told[1]
    assert told[2] == told[3]
    assert "no entry can be taken back" in told[2]
    assert all(one.startswith("To mend it: ") for one in told)


def test_a_posterior_that_is_not_trusted_or_provisional_is_shown_as_such(watched: Watched) -> None:
    def worse(route: Route) -> None:
        answer = route.fetch()
        body = answer.json()
        told = {"contradicted": [{"blade": "B2"}], "exchanged": [{"blades": ["B1", "B3"]}]}
        health = {"status": "contradicted", "trusted": False, "reasons": ["B2 fits no noise"]}
        body["health"] = body["health"] | health | told
        body["posterior"]["sealed"] = False
        route.fulfill(response=answer, json=body)

    watched.page.route("**/v1/rotors/r1", worse)
    page = watched.open("/rotors/r1")
    expect(page.locator("#notice .bad")).to_contain_text("not to be trusted (contradicted)")
    expect(page.locator("#states")).to_contain_text("provisional")
    for blade, what in (("B2", "contradicts the rotor"), ("B1", "readings look exchanged")):
        row = page.get_by_role("region", name="Blades").locator("tr", has_text=blade)
        expect(row).to_contain_text(what)


def test_a_blade_whose_input_is_held_at_the_runs_end_is_shown_as_such(watched: Watched) -> None:
    page = watched.open("/rotors/r1/blades/B1")
    expect(page.locator("#notice")).not_to_contain_text("Later hours")

    def held(route: Route) -> None:
        answer = route.fetch()
        route.fulfill(response=answer, json=answer.json() | {"held_from_h": 41_000.0})

    page.route("**/v1/rotors/r1/blades/B1/prediction*", held)
    page = watched.open("/rotors/r1/blades/B1")
    notice = page.locator("#notice .warn")
    expect(notice).to_contain_text(re.compile(r"From 41,000\sh on an adopted effect"))
    expect(notice).to_contain_text("Later hours have too little of the effect.")


def test_blades_held_by_the_hour_of_a_rotor_s_table_are_marked_there(watched: Watched) -> None:
    def held(route: Route) -> None:
        answer = route.fetch()
        told = answer.json()
        told["items"][0]["prediction"]["held_from_h"] = 41_000.0
        told["items"][1]["prediction"]["held_from_h"] = told["time_h"] + 1.0
        route.fulfill(response=answer, json=told)

    watched.page.route("**/v1/rotors/r1/blades?*", held)
    page = watched.open("/rotors/r1?time_h=50000")
    marked = page.get_by_text(re.compile(r"^▲? ?too little of an effect from 41,000\sh on$"))
    expect(marked).to_have_count(1)
    expect(page.locator(".ring .mark")).to_have_text("▲")


def test_a_rotor_of_wide_runs_is_shown_at_the_usual_hour(watched: Watched) -> None:
    """Its blades are asked for at 50,000 h, unless an hour was chosen."""

    def wide(route: Route) -> None:
        answer = route.fetch()
        route.fulfill(response=answer, json=answer.json() | {"horizon_h": 150_000.0})

    asked: list[str] = []
    watched.page.route("**/v1/models/*", wide)
    watched.page.on("request", lambda one: asked.append(one.url))
    watched.open("/rotors/r1")
    assert any("/v1/rotors/r1/blades?" in one and "time_h=50000" in one for one in asked)
    watched.open("/rotors/r1?time_h=20000")
    assert any("/v1/rotors/r1/blades?" in one and "time_h=20000" in one for one in asked)


def test_the_time_to_a_limit_is_the_service_s(watched: Watched, service: Running) -> None:
    """Of a scalar, and of one direction of a vector."""
    for quantity, limit, more in (
        ("elongation", 0.3, {}),
        ("deformation", 0.1, {"component": "z"}),
    ):
        asked = {"quantity": quantity, "limit": limit} | more
        told = service.client.get("/v1/rotors/r1/blades/B1/life", params=asked).json()
        half, chance = told["quantiles"]["0.5"], percent(told["passed"][-1])
        page = watched.open(f"/rotors/r1/blades/B1?quantity={quantity}&limit={limit}")
        heading = page.get_by_role("heading", name="At the end")
        panel = page.locator("section").filter(has=heading)
        assert half is not None
        said = f"{round(half / 10) * 10:,}".replace(",", r"\D?") + r"\sh"
        expect(panel.locator(".figure").last).to_have_text(re.compile(said))
        expect(panel).to_contain_text(f" h: {chance}.")
    assert watched.errors == []


def test_the_chances_to_pass_a_limit_are_the_service_s(watched: Watched, service: Running) -> None:
    """Of each blade in a column that sorts, and of the rotor in a sentence; alarms go by them."""
    page = watched.open("/rotors/r1?limit=0.4&time_h=32000")
    asked = {"limit": 0.4, "times": 32_000}
    told = service.client.get("/v1/rotors/r1/life", params=asked).json()
    chance = page.evaluate(
        """async (shares) => {
            const { percent } = await import("/assets/format.js");
            return shares.map(percent);
        }""",
        [told["any"][0], *(one["passed"][0] for one in told["blades"])],
    )
    heading = page.get_by_role("heading", name="Blades", exact=True)
    panel = page.locator("section").filter(has=heading)
    said = f"{told['expected'][0]:.1f} blades expected past 0.4\u00a0mm; at least one with "
    expect(panel).to_contain_text(f"of each blade’s own operation: {said}{chance[0]}.")
    table = page.get_by_role("region", name="Blades")
    heads = table.locator("th").all_text_contents()
    place = heads.index("Chance past the limit")
    rows = table.locator("tbody tr")
    for row, one, text in zip(rows.all(), told["blades"], chance[1:], strict=True):
        assert row.locator("td").first.text_content() == one["id"]
        assert row.locator("td").nth(place).text_content() == text
        alarm = row.locator(".states").all_text_contents()
        assert ("limit" in "".join(alarm)) == (one["passed"][0] >= 0.023)
    assert max(one["passed"][0] for one in told["blades"]) >= 0.023, "the control: one is told"
    table.get_by_role("button", name="Chance past the limit").click()
    expect(table.locator("th[aria-sort=ascending]")).to_have_text(re.compile("Chance"))
    last = max(told["blades"], key=lambda one: one["passed"][0])["id"]
    expect(rows.last.locator("td").first).to_have_text(last)
    page.get_by_role("combobox", name="Colour").select_option("chance")
    expect(page.get_by_text("A blade's colour is its chance past the limit")).to_be_visible()
    plain = watched.open("/rotors/r1")
    expect(plain.get_by_role("columnheader", name="Chance")).to_have_count(0)
    assert watched.errors == []


def test_chances_by_the_next_outage_are_by_each_blade_s_own_age(
    watched: Watched, service: Running
) -> None:
    page = watched.open("/rotors/r1?limit=0.4")
    field = page.get_by_role("spinbutton", name="passed within")
    field.fill("8000")
    field.press("Enter")
    told = service.client.get("/v1/rotors/r1/life", params={"limit": 0.4, "ahead": 8000}).json()
    heading = page.get_by_role("heading", name="Blades", exact=True)
    panel = page.locator("section").filter(has=heading)
    said = rf"{told['expected'][0]:.1f} blades expected past 0\.4\smm; at least one with "
    expect(panel).to_contain_text(re.compile(rf"Within 8\D?000\sh from now on: {said}"))
    table = page.get_by_role("region", name="Blades")
    heads = [
        re.sub(r"[\s\W]+", " ", head).strip() for head in table.locator("th").all_text_contents()
    ]
    assert "Margin sd" not in heads, "it would be of the table's hour"
    place = heads.index("Age")
    ages = {one["id"]: one["age_h"] for one in told["blades"]}
    assert len({*ages.values()}) > 1 or None not in ages.values()
    for row in table.locator("tbody tr").all():
        cells = row.locator("td")
        age = ages[str(cells.first.text_content())]
        assert re.sub(r"\D", "", str(cells.nth(place).text_content())) == f"{age:.0f}"
    assert "ahead=8000" in page.url
    field = page.get_by_role("spinbutton", name="passed within")
    field.fill("49999")
    field.press("Enter")
    expect(page.get_by_text(re.compile("the model ends at 50000 h"))).to_be_visible()
    watched.errors.clear()


def test_percents_are_whole_in_the_middle_and_tenths_at_the_ends(watched: Watched) -> None:
    page = watched.open("/rotors/r1")
    told = page.evaluate("""async () => {
      const { percent } = await import("/assets/format.js");
      return [0.0312, 0.634, 0.0042, 0.9958, 1e-9, 0, 1, null].map(percent);
    }""")
    words = [None if one == "–" else one.replace("\u00a0", " ") for one in told]
    shares = (0.0312, 0.634, 0.0042, 0.9958, 1e-9, 0.0, 1.0)
    assert words == [*map(percent, shares), None], "as in the terminal"


def test_hours_and_ticks_have_the_decimals_that_their_range_needs(watched: Watched) -> None:
    page = watched.open("/rotors/r1/blades/B1")
    told = page.evaluate(
        """async () => {
            const { hoursOf, labels } = await import("/assets/format.js");
            const told = [hoursOf(12346, 50000), hoursOf(3.4214, 12), hoursOf(0.4567, 0.9)];
            return [...told, ...labels([0, 2.5, 5])];
        }"""
    )
    shown = [re.sub(r"\D", "", text) if "h" in text else text for text in told]
    assert shown == ["12350", "342", "04567", "0.0", "2.5", "5.0"]


def test_digits_are_counted_once_a_number_is_rounded(watched: Watched) -> None:
    page = watched.open("/rotors/r1")
    told = page.evaluate("""async () => {
      const { plain, withSd } = await import("/assets/format.js");
      const alone = [0.996, 1, 0.994, 0, null].map((value) => plain(value, 2));
      return [...alone, withSd(2, 0.0996), withSd(-12345.6, 1200), plain(1234, 4)];
    }""")
    assert told[:6] == ["1.0", "1.0", "0.99", "0", "–", "2.00 ± 0.10"]
    assert told[6:] == ["−12,346 ± 1,200", "1,234"], "as the terminal and reports have them"


def test_slots_are_counted_from_nought_or_from_one_and_have_to_be_numbers(watched: Watched) -> None:
    page = watched.open("/rotors/r1")
    told = page.evaluate("""async () => {
      const { slots } = await import("/assets/ring.js");
      const of = (...given) => slots(given.map((slot) => ({ slot })));
      const every = [of("0", "2"), of("1", "3"), of("7", "A"), of(null, null)];
      return every.map((one) => [one.count, one.of, one.order]);
    }""")
    assert told == [
        [3, [0, 2], "by slot, front view"],
        [3, [0, 2], "by slot, front view"],
        [2, [0, 1], "by name: slots are not all numbers"],
        [2, [0, 1], "by name: no slots are given"],
    ]


def test_a_wide_model_s_last_hours_are_shown_where_something_was_read_there(
    watched: Watched,
) -> None:
    page = watched.open("/rotors/r1")
    told = page.evaluate("""async () => {
      const { usual, usualHours } = await import("/assets/ahead.js");
      const wide = { horizon_h: 150000, time_h: [0, 20000, 60000, 150000] };
      const narrow = { horizon_h: 50000, time_h: [0, 20000, 50000] };
      return [usual(wide), usual(wide, 24000), usual(wide, 51000), usual(narrow),
        usualHours(wide), usualHours(wide, 51000), usualHours(narrow)];
    }""")
    assert told == [50_000, 50_000, 150_000, 50_000, "0,20000,50000", None, None]


def test_a_service_that_is_away_is_told_and_the_page_comes_back(watched: Watched) -> None:
    page = watched.open("/rotors/r1")
    page.route("**/v1/**", lambda route: route.abort())
    limit = page.get_by_role("spinbutton", name="Limit")
    limit.fill("0.4")
    limit.press("Enter")
    expect(page.locator("#notice")).to_contain_text("The service is away.")
    expect(page.locator("#notice")).to_contain_text("what was known before")
    assert page.locator(".ring a").count() == 4, "what was known stays"
    page.unroute("**/v1/**")
    expect(page.locator("#notice")).to_be_empty()
    expect(page.get_by_role("columnheader", name="Margin")).to_be_visible()


def test_a_page_whose_first_drawing_fails_is_drawn_when_the_service_answers(
    watched: Watched,
) -> None:
    """Blades, rotors and fields build their places once, before anything is there to show."""
    for path in ("/rotors/r1/blades/B1", "/rotors/r1", "/rotors/r1/residuals"):
        page = watched.page
        page.route("**/v1/**", lambda route: route.abort())
        watched.open(path, state="failed")
        expect(page.locator("#notice")).to_contain_text("The service is away.")
        expect(page.locator("#live")).to_have_text("away")
        assert not page.locator("#page").is_visible()
        page.unroute("**/v1/**")
        page.wait_for_selector("body[data-state=ready]", state="attached")
        expect(page.locator("#page")).to_be_visible()
        expect(page.locator("#page").locator("h2, p").first).to_be_visible()
        expect(page.locator("#live")).not_to_have_text("away")
    watched.open("/rotors/r1/blades/B1")
    assert page.locator("canvas").first.is_visible()


def test_a_table_outlives_the_column_that_it_is_sorted_by(watched: Watched) -> None:
    page = watched.open("/rotors/r1")
    limit = page.get_by_role("spinbutton", name="Limit")
    limit.fill("0.4")
    limit.press("Enter")
    table = page.get_by_role("region", name="Blades")
    table.get_by_role("button", name="Margin").click()
    expect(table.locator("th[aria-sort=ascending]")).to_have_text(re.compile("Margin"))
    limit.fill("")
    limit.press("Enter")
    expect(page.get_by_role("columnheader", name="Margin")).to_have_count(0)
    expect(table.locator("th[aria-sort=ascending]")).to_have_text(re.compile("Blade"))
    table.get_by_role("button", name="Received").click()
    limit.fill("0.4")
    limit.press("Enter")
    expect(page.get_by_role("columnheader", name="Margin")).to_be_visible()
    expect(table.locator("th[aria-sort=ascending]")).to_have_text(re.compile("Received"))
    assert watched.errors == []


SEEN = """hidden => {
    Object.defineProperty(document, "hidden", { value: hidden, configurable: true });
    document.dispatchEvent(new Event("visibilitychange"));
}"""


def test_a_page_that_nobody_looks_at_lets_its_stream_go(watched: Watched) -> None:
    """A browser has six connections to a server: six such pages would keep out a seventh."""
    page = watched.open("/rotors/r1")
    expect(page.locator("#live")).to_have_text("live")
    ended: list[str] = []
    page.on("requestfailed", lambda request: ended.append(request.url))
    page.evaluate(SEEN, True)
    expect(page.locator("#live")).to_have_text("not live: connecting")
    assert any(url.endswith("/v1/rotors/r1/events") for url in ended)
    page.wait_for_timeout(1500)
    expect(page.locator("#live")).to_have_text("not live: connecting")
    page.evaluate(SEEN, False)
    expect(page.locator("#live")).to_have_text("live")


def test_scales_of_next_to_nothing_have_ticks_and_an_end(watched: Watched) -> None:
    page = watched.open("/rotors/r1")
    told = page.evaluate(
        """async () => {
            const { span, ticks } = await import("/assets/scale.js");
            const next = [600, 600.0000000000001];
            return [ticks(next).length, ticks(span(next)).length, ticks([0, 1e-13]).length,
                    ticks([0, 50000]).length];
        }"""
    )
    assert told[0] <= 100
    assert all(3 <= count <= 11 for count in told[1:])


def test_what_is_not_there_is_told_and_draws_nothing(watched: Watched) -> None:
    for path in ("/rotors/none", "/rotors/r1/blades/none", "/models/none"):
        page = watched.open(path, state="failed")
        expect(page.locator("#notice")).to_contain_text("Not found, or not for this key.")
        assert page.locator("canvas, .ring").count() == 0


def test_a_key_is_typed_once_and_kept_for_the_tab(watched: Watched) -> None:
    sent: list[str] = []

    def locked(route: Route) -> None:
        given = route.request.headers.get("authorization", "")
        sent.append(given)
        if given != "Bearer btk_right":
            route.fulfill(status=401, json={"type": "urn:bladetwin:problem:key-required"})
            return
        headers = {k: v for k, v in route.request.headers.items() if k != "authorization"}
        route.continue_(headers=headers)

    page = watched.page
    page.route("**/v1/**", locked)
    page.goto(watched.service.url + "/rotors/r1/readings")
    field = page.get_by_label("API key", exact=True).last
    field.fill("btk_wrong")
    page.get_by_role("button", name="Use it").click()
    expect(page.get_by_text("This key is not accepted.")).to_be_visible()
    page.get_by_label("API key", exact=True).last.fill("btk_right")
    page.get_by_role("button", name="Use it").click()
    page.wait_for_selector("body[data-state=ready]", state="attached")
    watched.open("/rotors/r1/readings")
    assert page.get_by_role("dialog").count() == 0
    assert "" in sent
    assert "Bearer btk_wrong" in sent
    assert page.evaluate("localStorage.length") == 0


def test_a_diagnosis_is_asked_for_watched_and_cancelled(watched: Watched) -> None:
    page = watched.open("/rotors/r1/diagnoses")
    page.get_by_role("button", name="Look for what the model lacks").click()
    page.wait_for_url("**/diagnoses/*")
    expect(page.locator("#states")).to_contain_text("queued")
    expect(page.get_by_text("it begins when a worker")).to_be_visible()
    assert page.get_by_role("button", name="Adopt").count() == 0
    page.get_by_role("button", name="Cancel").click()
    expect(page.locator("#states")).to_contain_text("cancelled")
    expect(page.locator("#notice")).to_contain_text("there is no result")


# Cells of tables whose contents reach into the next one.
SPILT = """() => [...document.querySelectorAll("td")].filter((cell) => cell.getBoundingClientRect().width > 0
  && [...cell.querySelectorAll("*")].some((one) =>
    one.getBoundingClientRect().right > cell.getBoundingClientRect().right + 1)).map((cell) => cell.textContent)"""  # noqa: E501
# Regions that have to be scrolled sideways.
SIDEWAYS = """() => [...document.querySelectorAll(".scroll")]
  .filter((one) => one.scrollWidth > one.clientWidth + 1).map((one) => one.ariaLabel)"""


def test_no_state_covers_the_number_beside_it(watched: Watched) -> None:
    """The longest states are those of the blades that matter; at 1,400 points all columns are seen."""  # noqa: E501

    def worse(route: Route) -> None:
        answer = route.fetch()
        body = answer.json()
        health = {"status": "contradicted", "trusted": False, "contradicted": [{"blade": "B2"}]}
        body["health"] = body["health"] | health
        route.fulfill(response=answer, json=body)

    def listed(route: Route) -> None:
        body = route.fetch().json()
        grave = {"status": "contradicted", "trusted": False}
        body["items"] = [one | {"health": one["health"] | grave} for one in body["items"]]
        route.fulfill(json=body)

    page = watched.page
    page.route("**/v1/rotors/r1", worse)
    page.route("**/v1/rotors?*", listed)
    page.set_viewport_size({"width": 1400, "height": 900})
    for path, said in (
        ("/rotors/r1?limit=0.001", r"beyond the limit \(>\s99.9\s%\)"),
        ("/", "not trusted: contradicted"),
    ):
        watched.open(path)
        expect(page.locator("td .state.bad", has_text=re.compile(said)).first).to_be_visible()
        assert page.evaluate(SPILT) == [], path
        assert page.evaluate(SIDEWAYS) == [], path
    page.evaluate(
        "document.querySelector('td .states').style.cssText = 'position: relative; left: 900px'"
    )
    assert page.evaluate(SPILT) != [], "negative control"


def test_a_limit_is_told_with_every_digit_of_it(watched: Watched) -> None:
    page = watched.open("/rotors/r1/blades/B1?limit=0.123456")
    expect(page.get_by_text("median time to 0.123456 mm")).to_be_visible()
    chance = page.get_by_text("Chance to have passed it by")
    expect(chance).to_contain_text(re.compile(r"by 50,000\sh: >\s99.9\s%"))
    expect(chance).not_to_contain_text("100.0")
    watched.open("/rotors/r1?limit=0.123456")
    expect(page.get_by_text("blades expected past 0.123456 mm")).to_be_visible()


def test_a_number_of_values_is_no_length(watched: Watched) -> None:
    page = watched.open("/rotors/r1/readings")
    row = page.get_by_role("row", name="deformation")
    expect(row).to_contain_text("14 values in mm")


def test_long_names_lie_on_nothing(watched: Watched) -> None:
    """Sixty signs, as serial numbers have them: in the ring, and below and above the heat map."""
    page = watched.open("/rotors/r1")
    on, labels = page.evaluate("""async () => {
      const [{ ring }, { heat }, { h }] = await Promise.all(["ring", "heat", "dom"].map((one) => import(`/assets/${one}.js`)));
      const named = (count) => Array.from({ length: count }, (_, i) => ({ id: `TURBINE-BLADE-SERIAL-NUMBER-OF-SIXTY-SIGNS-AND-A-TAIL-${1000 + i}`, slot: null, lot: `lot ${"W".repeat(50)} ${i % 3}` }));
      const how = { value: () => 0.4, span: [0, 1], what: "mean", unitName: "mm", tell: (b) => b.id, sign: () => null };
      const items = (blades) => blades.map((b, i) => ({ blade: b.id, visit: 1, time_h: 1, rotor_h: 1, z: i % 3, quantity: "elongation" }));
      const made = [2, 12, 40, 41].flatMap((count) => [ring("r", named(count), how), heat(items(named(count)), [{ visit: 1, from_h: 1 }], named(count), "lot")]);
      const place = h("div");
      place.style.width = "900px";
      place.append(...made);
      document.body.append(place);
      const pairs = made.flatMap((svg) => {
        const words = [...svg.querySelectorAll("text")].map((t) => [t.textContent, t.getBoundingClientRect()]).filter(([, box]) => box.width > 0);
        return words.flatMap(([a, one], i) => words.slice(i + 1).filter(([, two]) => Math.min(one.right, two.right) - Math.max(one.left, two.left) > 2
          && Math.min(one.bottom, two.bottom) - Math.max(one.top, two.top) > 2).map(([b]) => `${a} | ${b}`));
      });
      return [pairs, made.map((svg) => [...svg.querySelectorAll("text")].filter((t) => t.textContent.startsWith("…")).length)];
    }""")  # noqa: E501
    assert on == []
    assert min(labels[0], labels[1], labels[2], labels[3]) > 1, "the ends of names are there"


def test_what_was_not_read_is_told_apart_from_what_was_as_predicted(watched: Watched) -> None:
    """Not by a grey beside a white alone."""
    page = watched.open("/rotors/r1")
    cells, dashes = page.evaluate("""async () => {
      const { heat } = await import("/assets/heat.js");
      const items = [["B1", 1], ["B2", 2]].map(([blade, visit]) => ({ blade, visit, time_h: 1, rotor_h: 1, z: 0, quantity: "elongation" }));
      const made = heat(items, [{ visit: 1, from_h: 1 }, { visit: 2, from_h: 2 }], [{ id: "B1" }, { id: "B2" }], "blade");
      return [made.querySelectorAll("rect title").length, made.querySelectorAll("line").length];
    }""")  # noqa: E501
    assert (cells, dashes) == (4, 2)


def test_a_blade_s_number_is_read_on_every_colour_of_the_ring(watched: Watched) -> None:
    page = watched.open("/rotors/r1")
    least = page.evaluate("""async () => {
      const { rgb, dark } = await import("/assets/scale.js");
      const bright = (c) => c.map((v) => v / 255).map((v) => (v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4))
        .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
      const ink = (name) => {
        const one = document.createElementNS("http://www.w3.org/2000/svg", "text");
        one.setAttribute("class", name);
        document.querySelector(".ring").append(one);
        return bright(getComputedStyle(one).fill.match(/\\d+/g).map(Number));
      };
      const inks = { true: ink("on-light"), false: ink("on-dark") };
      const shares = Array.from({ length: 201 }, (_, i) => i / 200);
      return Math.min(...shares.map((s) => {
        const two = [bright(rgb(s)), inks[dark(s)]].sort((a, b) => a - b);
        return (two[1] + 0.05) / (two[0] + 0.05);
      }));
    }""")  # noqa: E501
    assert least >= 4.5


def test_a_page_is_printed_whole(watched: Watched) -> None:
    """A table that is scrolled on a screen has all its rows on paper, and nothing to press."""
    page = watched.open("/rotors/r1/blades/B1?limit=0.3")
    page.set_viewport_size({"width": 1000, "height": 500})
    page.evaluate("""() => {
      const body = document.querySelector('.scroll tbody');
      for (let i = 0; i < 60; i += 1) body.append(body.rows[0].cloneNode(true));
    }""")
    cut = """() => [...document.querySelectorAll(".scroll")]
      .filter((one) => one.scrollHeight > one.clientHeight + 1).length"""
    assert page.evaluate(cut) > 0, "negative control: on a screen it is scrolled"
    page.emulate_media(media="print", color_scheme="dark")
    assert page.evaluate(cut) == 0
    expect(page.get_by_role("button", name="Key")).to_be_hidden()
    expect(page.get_by_role("navigation", name="Main")).to_be_hidden()
    ink = page.evaluate("getComputedStyle(document.documentElement).getPropertyValue('--ink')")
    assert ink == "#16202a", "dark on white, whatever the screen was"


def test_what_stands_is_not_said_or_drawn_again(watched: Watched) -> None:
    """A page that reads every three seconds: a screen reader would hear its alert each time."""

    def worse(route: Route) -> None:
        answer = route.fetch()
        body = answer.json()
        health = {"status": "contradicted", "trusted": False, "reasons": ["B2 fits no noise"]}
        route.fulfill(response=answer, json=body | {"health": body["health"] | health})

    reads: list[str] = []
    page = watched.page
    page.route("**/v1/rotors/r1", worse)
    page.on("request", lambda one: reads.append(one.url) if "diagnoses?" in one.url else None)
    watched.open("/rotors/r1/diagnoses")
    expect(page.locator("#notice .bad")).to_contain_text("B2 fits no noise")
    page.evaluate("""() => {
      window.said = 0;
      const look = new MutationObserver(() => { window.said += 1; });
      look.observe(document.querySelector("#notice"), { childList: true, subtree: true, characterData: true });
      look.observe(document.querySelector("main section:last-child"), { childList: true, subtree: true, characterData: true });
    }""")  # noqa: E501
    before = len(reads)
    assert comes(page, lambda: len(reads) > before + 2)
    assert page.evaluate("window.said") == 0


def test_the_ring_is_one_stop_of_the_tab_key(watched: Watched) -> None:
    """A hundred blades before the table, which has them again; arrow keys go round."""
    page = watched.open("/rotors/r1")
    ring = page.locator(".ring a")
    expect(ring.locator("xpath=self::*[@tabindex='0']")).to_have_count(1)
    ring.first.focus()
    reached = "document.activeElement.getAttribute('href')"
    for key, blade in (
        ("ArrowRight", "B2"),
        ("ArrowLeft", "B1"),
        ("ArrowLeft", "B4"),
        ("Home", "B1"),
    ):
        page.keyboard.press(key)
        assert page.evaluate(reached) == f"/rotors/r1/blades/{blade}", key
    expect(ring.locator("xpath=self::*[@tabindex='0']")).to_have_count(1)
    page.keyboard.press("Tab")
    assert not page.evaluate("Boolean(document.activeElement.closest('.ring'))")
    page.keyboard.press("Shift+Tab")
    assert page.evaluate(reached) == "/rotors/r1/blades/B1"


def test_who_has_no_key_is_not_kept_before_the_question(watched: Watched) -> None:
    page = watched.open("/rotors/r1/readings")
    page.get_by_role("button", name="Key").click()
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog")).to_have_count(0)
    expect(page.get_by_role("region", name="Readings")).to_be_visible()
    refused = {"type": "urn:bladetwin:problem:key-required"}
    page.route("**/v1/**", lambda route: route.fulfill(status=401, json=refused))
    page.goto(watched.service.url + "/")
    page.get_by_role("button", name="Cancel").click()
    page.wait_for_selector("body[data-state=failed]", state="attached")
    expect(page.locator("#notice")).to_contain_text("A key is needed.")
    with page.expect_request("**/v1/rotors?*", timeout=PATIENCE_MS):
        pass  # it reads by the clock, and does not ask by the clock
    page.wait_for_timeout(200)
    expect(page.get_by_role("dialog")).to_have_count(0)
    assert page.evaluate("sessionStorage.length") == 0


def test_pictures_stay_large_enough_to_read_on_a_telephone(
    watched: Watched, diagnosis: str
) -> None:
    """They are scrolled in their place; letters of 12 points are not drawn with five."""
    page = watched.page
    page.set_viewport_size({"width": 400, "height": 800})
    small = """() => [document, ...[...document.querySelectorAll(".pictured")].map((one) => one.shadowRoot)]
      .flatMap((root) => [...root.querySelectorAll("svg text")])
      .filter((one) => one.getBoundingClientRect().height > 0 && one.getBoundingClientRect().height < 8)
      .map((one) => one.textContent)"""  # noqa: E501
    for path in ("/rotors/r1/diagnoses/{d}", "/rotors/r1/blades/B1"):
        watched.open(path.replace("{d}", diagnosis))
        assert page.evaluate(small) == [], path
        assert page.evaluate("document.documentElement.scrollWidth") == 400
    widest = (
        "all => Math.max(0, ...all.map((one) => one.clientWidth))"  # zero while it is drawn anew
    )
    assert comes(page, lambda: page.locator("canvas.plot").evaluate_all(widest) > 400)


def test_a_report_is_read_on_a_telephone(watched: Watched, diagnosis: str) -> None:
    """Its tables were columns of one letter there."""
    page = watched.page
    page.set_viewport_size({"width": 400, "height": 800})
    page.goto(f"{watched.service.url}/v1/rotors/r1/diagnoses/{diagnosis}/report")
    assert page.evaluate("document.documentElement.scrollWidth") == 400
    narrow = page.evaluate(
        """() => [...document.querySelectorAll("td")].filter((one) => one.textContent.length > 12
          && one.clientWidth < 40).map((one) => one.textContent)"""
    )
    assert narrow == []
    assert serious(page) == []

"""Pages are shells: open, without data, with nothing from elsewhere."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import AbstractContextManager
from hashlib import sha256
from pathlib import Path

import httpx
import pytest

from service.pages.routes import ASSET, PAGES, STATIC, assets

Serving = Callable[..., AbstractContextManager[httpx.Client]]
VENDORED = (STATIC / "vendor", Path(__file__).parents[1] / "browser" / "vendor")
OUTSIDE = re.compile(r"""(?:src|href|from|import|fetch\(|url\()\s*=?\s*\(?["']?(?:https?:)?//""")
INLINE = re.compile(r"<style|\sstyle=|\son[a-z]+=|<script(?![^>]*\ssrc=)|javascript:", re.I)
MARKUP = re.compile(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|eval\(|new Function")


def own_files() -> list[Path]:
    return [path for path in STATIC.iterdir() if path.suffix in (".js", ".css", ".svg")]


def filled(path: str) -> str:
    return path.replace("{r}", "r1").replace("{b}", "B1").replace("{d}", "d1").replace("{m}", "m")


def test_a_stranger_gets_every_page_and_no_word_of_the_data(serving: Serving, rotor: str) -> None:
    with serving(keys="always") as client:
        for path in PAGES:
            answer = client.get(filled(path))
            assert answer.status_code == 200, path
            assert answer.headers["content-type"] == "text/html; charset=utf-8"
            there, gone = (
                client.get(filled(path).replace("r1", name)).text for name in ("r1", "zz")
            )
            assert there.replace("r1", "") == gone.replace("zz", ""), "no rotor is told of"
            told = client.post(filled(path))
            assert told.status_code == 401, "only GET is open"
        assert client.get("/v1/rotors").status_code == 401, "negative control"
        assert client.get("/nowhere").status_code == 401


def test_names_in_a_path_stay_text(api: httpx.Client) -> None:
    hostile = "%3Cimg%20src=x%20onerror=alert(1)%3E%22%20onload=%22x"
    text = api.get(f"/rotors/{hostile}").text
    assert "<img" not in text
    assert '" onload="' not in text
    assert "&lt;img src=x onerror=alert(1)&gt;&#34; onload=&#34;x" in text, "it is there, as text"
    beyond = api.get("/rotors/%3Cscript%3E%2F")
    assert beyond.headers["content-type"] == "application/problem+json", "never read as a page"


def test_shells_and_scripts_need_nothing_inline_and_nothing_from_elsewhere(
    api: httpx.Client,
) -> None:
    for path in PAGES:
        answer = api.get(filled(path))
        assert INLINE.search(answer.text) is None, path
        assert OUTSIDE.search(answer.text) is None, path
        assert "default-src 'self'" in answer.headers["content-security-policy"]
        for asset in re.findall(r'(?:src|href)="(/assets/[^"]+)"', answer.text):
            assert api.get(asset).status_code == 200, asset
    for file in own_files():
        text = file.read_text()
        assert OUTSIDE.search(text) is None, file
        assert MARKUP.search(text) is None, f"{file}: what the service says becomes text only"
        for module in re.findall(r'from "\./([^"]+)"', text):
            assert module in assets(), f"{file.name} imports {module}"


@pytest.mark.parametrize(
    ("pattern", "text"),
    [
        (INLINE, "<script>x()</script>"),
        (INLINE, '<p style="color: red">'),
        (OUTSIDE, '<script src="https://cdn.example/x.js">'),
        (OUTSIDE, 'import x from "//cdn.example/x.js"'),
        (MARKUP, "place.innerHTML = name"),
    ],
)
def test_a_breach_is_seen(pattern: re.Pattern[str], text: str) -> None:
    """Negative control: each kind of breach is found."""
    assert pattern.search(text)


def test_assets_are_files_of_the_folder_alone_and_have_tags(api: httpx.Client) -> None:
    first = api.get("/assets/dom.js", headers={"Accept-Encoding": "identity"})
    assert first.headers["content-type"].startswith("text/javascript")
    assert first.content == (STATIC / "dom.js").read_bytes()
    again = api.get("/assets/dom.js", headers={"If-None-Match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    for path in ("../routes.py", "%2e%2e/routes.py", "vendor/", "/etc/passwd", "nothing.js"):
        assert api.get(f"/assets/{path}").status_code == 404, path


def breaches(folder: Path) -> list[str]:
    """Files that differ from the list of vendored ones, or stand in it without being there."""
    listed = dict(
        reversed(line.split("  "))
        for line in (folder / "VENDORED").read_text().splitlines()
        if line and not line.startswith("#")
    )
    there = {
        path.name: sha256(path.read_bytes()).hexdigest()
        for path in folder.iterdir()
        if path.name != "VENDORED"
    }
    return sorted(name for name in listed | there if listed.get(name) != there.get(name))


@pytest.mark.parametrize("folder", VENDORED, ids=lambda path: path.parent.name)
def test_vendored_files_are_what_their_list_says(folder: Path, tmp_path: Path) -> None:
    assert breaches(folder) == []
    copy = tmp_path / "copy"
    copy.mkdir()
    for path in folder.iterdir():
        (copy / path.name).write_bytes(path.read_bytes())
    changed = next(path for path in copy.iterdir() if path.suffix == ".js")
    changed.write_bytes(changed.read_bytes() + b"\n")
    (copy / "more.js").write_text("")
    assert breaches(copy) == sorted([changed.name, "more.js"]), "negative control"


def test_every_page_has_its_script() -> None:
    scripts = {script for _, script in PAGES.values()}
    assert {f"{script}.js" for script in scripts} <= set(assets())
    assert ASSET == "/assets/{name:path}"

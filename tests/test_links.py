"""Links of the documents lead somewhere: to a file that is there, and to a heading in it."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parent.parent
DOCUMENTS = sorted(
    path
    for room in (".", "core", "service", "tests/claims", "tests/benchmarks")
    for path in (ROOT / room).glob("*.md")
)
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
PATH = re.compile(r"`((?:core|service|tests|docker|migrations)/(?!secrets/)[\w./-]*)`")
"""`docker/secrets` is made by `docker/secrets.sh`."""


def plain(text: str) -> str:
    """Without what is code: blocks, and words between backticks."""
    return re.sub(r"`[^`\n]*`", "", re.sub(r"```.*?```", "", text, flags=re.DOTALL))


def anchors(text: str) -> set[str]:
    """What can be linked to, as the usual renderers name it; a second one of a name is -1."""
    found: list[str] = []
    headings = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    for heading in re.findall(r"^#+ (.+?)\s*$", headings, re.MULTILINE):
        name = re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        again = sum(one == name or one.rpartition("-")[0] == name for one in found)
        found.append(f"{name}-{again}" if name in found else name)
    return set(found)


def leads_nowhere(document: Path, text: str) -> list[str]:
    """Its links to a file, or a heading, that is not there, and its paths in backticks that are
    none; links to other places on the network are not followed."""
    here = {document: text}
    broken = []
    for link in LINK.findall(plain(text)):
        if re.match(r"[a-z]+:", link):
            continue
        file, _, anchor = link.partition("#")
        target = (document.parent / file).resolve() if file else document
        there = target.is_relative_to(ROOT) and target.exists()
        if there and anchor:
            there = anchor in anchors(here.get(target) or target.read_text())
        broken += [] if there else [link]
    named = ((path, ROOT / path) for path in PATH.findall(text))
    return broken + [name for name, path in named if not (path.exists() or module(path).exists())]


def module(path: Path) -> Path:
    """A module that is named without its ending."""
    return path.with_name(f"{path.name}.py")


def test_every_link_of_the_documents_leads_somewhere() -> None:
    assert len(DOCUMENTS) >= 9
    found = {
        str(path.relative_to(ROOT)): leads_nowhere(path, path.read_text()) for path in DOCUMENTS
    }
    assert {name: broken for name, broken in found.items() if broken} == {}


def test_every_document_can_be_reached_from_the_first() -> None:
    seen: set[Path] = set()
    left = [ROOT / "README.md"]
    while left:
        document = left.pop()
        if document in seen:
            continue
        seen.add(document)
        files = (link.partition("#")[0] for link in LINK.findall(plain(document.read_text())))
        targets = ((document.parent / file).resolve() for file in files if file.endswith(".md"))
        left += [target for target in targets if target.exists()]
    assert set(DOCUMENTS) <= seen


def test_a_broken_link_is_seen() -> None:
    """Negative control: a file and a heading that are not there, and links that are."""
    text = (
        "## Two words\n\n## Two words\n\n[a](#two-words-1) [b](core/limits.md#posterior) `[c](d)`\n"
    )
    here = ROOT / "README.md"
    assert leads_nowhere(here, text) == []
    bad = text + "[e](core/none.md) [f](#three) [g](core/limits.md#none) [h](../x) `core/none.py`\n"
    told = ["core/none.md", "#three", "core/limits.md#none", "../x", "core/none.py"]
    assert leads_nowhere(here, bad) == told

"""Reads docker/Dockerfile and .dockerignore as a builder does, and holds them to our rules.

Only what our file uses is understood; anything else is an error, so that nothing goes unread.
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[2]
FILE = ROOT / "docker" / "Dockerfile"
KNOWN = {
    "FROM", "WORKDIR", "RUN", "COPY", "ENV", "VOLUME", "USER", "EXPOSE", "STOPSIGNAL",
    "HEALTHCHECK", "ENTRYPOINT", "CMD",
}  # fmt: skip
# A builder's own cache: what it holds changes how long a step takes, and nothing in the image.
CACHE = re.compile(r"--mount=type=cache,target=\S+ ")


@dataclass(slots=True)
class Stage:
    """One FROM and what follows it, in order."""

    image: str
    name: str
    steps: list[tuple[str, str]] = field(default_factory=list)

    def all(self, word: str) -> list[str]:
        return [text for one, text in self.steps if one == word]

    def last(self, word: str) -> str:
        found = self.all(word)
        if not found:
            raise ValueError(f"the last stage has no {word}")
        return found[-1]

    def argv(self, word: str) -> list[str]:
        """The words of an exec form; ValueError: it is a shell form."""
        text = self.last(word)
        if word == "HEALTHCHECK":
            text = text.partition("CMD")[2]
        try:
            words = json.loads(text)
        except ValueError:
            raise ValueError(f"{word} {text} is no exec form: signals reach a shell") from None
        return [str(one) for one in words]

    def environ(self) -> dict[str, str]:
        pairs = (pair for line in self.all("ENV") for pair in shlex.split(line))
        return {name: value for name, _, value in (pair.partition("=") for pair in pairs)}


def stages(text: str) -> list[Stage]:
    """The stages of a Dockerfile, in order."""
    lines = [line for line in text.splitlines() if not line.lstrip().startswith("#")]
    found: list[Stage] = []
    for line in "\n".join(lines).replace("\\\n", " ").splitlines():
        if not line.strip():
            continue
        word, _, rest = line.strip().partition(" ")
        if word not in KNOWN:
            raise ValueError(f"{word} is not understood here")
        rest = " ".join(rest.split())
        if word == "RUN":
            rest = CACHE.sub("", rest)
        if word == "FROM":
            image, _, name = rest.partition(" AS ")
            found.append(Stage(image, name))
        else:
            found[-1].steps.append((word, rest))
    return found


COMPILERS = re.compile(r"\b(gcc|g\+\+|cc|clang|make|build-essential|rustc|cargo)\b")


def faults(text: str) -> list[str]:
    """What breaks a rule of ours: rules that a general linter does not have."""
    found: list[str] = []
    built = stages(text)
    last = built[-1]
    if len(built) < 2 or not last.all("COPY") or "--from=" not in last.all("COPY")[0]:
        found.append("what builds is not apart from what runs")
    user = (last.all("USER") or ["root"])[-1]
    if not re.fullmatch(r"[1-9]\d*:[1-9]\d*", user):
        found.append(f"USER {user} is not a number above 0: nobody outside can tell it from root")
    for word in ("ENTRYPOINT", "CMD", "HEALTHCHECK"):
        try:
            words = last.argv(word)
        except ValueError as error:
            found.append(str(error))
            continue
        if {"curl", "wget", "sh", "bash"} & set(words):
            found.append(f"{word} {words} needs a program that the image need not have")
    for run in last.all("RUN"):
        if "apt-get" in run or "pip install" in run or COMPILERS.search(run):
            found.append(f"the image that runs installs things: {run}")
    for stage in built:
        for run in stage.all("RUN"):
            for part in re.findall(r"pip install[^&;|]*", run):
                if "--require-hashes" not in part and "--no-deps" not in part:
                    found.append(f"installed without hashes: {part.strip()}")
        if ":" not in stage.image or stage.image.endswith(":latest"):
            found.append(f"{stage.image} is another image every day")
    if "PASSWORD" in text or re.search(r"DATABASE_URL=", text):
        found.append("a secret, or the place for one, is in the image")
    return found


def visible(path: str, patterns: Sequence[str]) -> bool:
    """Whether a builder sees a file: of the patterns that match it or a folder of it, the last."""
    parts = path.split("/")
    prefixes = ["/".join(parts[: n + 1]) for n in range(len(parts))]
    seen = True
    for pattern in patterns:
        bare = pattern.removeprefix("!")
        if any(_pattern(bare).fullmatch(prefix) for prefix in prefixes):
            seen = pattern.startswith("!")
    return seen


def _pattern(text: str) -> re.Pattern[str]:
    made = "".join(
        {"**/": "(?:.*/)?", "*": "[^/]*", "?": "[^/]"}.get(part, re.escape(part))
        for part in re.split(r"(\*\*/|\*|\?)", text)
    )
    return re.compile(made)


def ignored() -> list[str]:
    lines = (ROOT / ".dockerignore").read_text().splitlines()
    return [line.strip() for line in lines if line.strip() and not line.startswith("#")]

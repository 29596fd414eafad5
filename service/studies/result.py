"""What every study's result holds, and where it is written: command, commit, state algorithm."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import typer

from core.calibration.state import ALGORITHM


def commit() -> str | None:
    """The checkout's commit, where there is one; with ``-dirty`` where files of it are changed."""

    def told(*words: str) -> str:
        done = subprocess.run(
            ["git", *words], capture_output=True, text=True, check=True, timeout=10
        )
        return done.stdout.strip()

    try:
        changed = told("status", "--porcelain", "--untracked-files=no")
        return told("rev-parse", "HEAD") + ("-dirty" if changed else "")
    except (OSError, subprocess.SubprocessError):
        return None


def write(result: dict[str, Any], made_by: str | None, out: Path | None) -> None:
    """A study's result on stdout, and as ``result.json`` in the folder `out`.

    made_by   the commit when the study began: a checkout may move on meanwhile
    """
    text = keep(result, made_by, out)
    typer.echo(text)


def keep(result: dict[str, Any], made_by: str | None, out: Path | None) -> str:
    """The same without the stdout; the text."""
    head = {"command": command_of(sys.argv[1:]), "commit": made_by, "algorithm": ALGORITHM}
    text = json.dumps(head | result, indent=1)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        (out / "result.json").write_text(text + "\n")
    return text


def command_of(words: Sequence[str]) -> str:
    """The command as a shell takes it; of a whole path the name alone, as where a folder lies is
    the machine's business.

    >>> command_of(["study", "power", "--only", "worn lot", "--work", "/data/of/mine/studies"])
    "bladetwin study power --only 'worn lot' --work studies"
    """
    return shlex.join(["bladetwin", *(Path(w).name if w.startswith("/") else w for w in words)])

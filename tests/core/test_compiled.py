"""Machine code kept on disk is renewed when any source of its room changes."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

from core.calibration import kernel
from core.compiled import stamp_of

CALLEE = "from core.compiled import compiled\n\n@compiled\ndef part(x):\n    return x + {}\n"
CALLER = """
from callee import part
from core.compiled import compiled

@compiled
def whole(x):
    return 2.0 * part(x)

"""


def run(folder: Path) -> tuple[float, int]:
    """whole(1.0) and how often machine code was found, by modules loaded anew."""
    stamp_of.cache_clear()
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        patch.setattr(sys, "dont_write_bytecode", True)
        whole = importlib.import_module("whole").whole
        value = whole(1.0)
        for name in ("whole", "callee", "plain"):
            sys.modules.pop(name, None)
    return float(value), sum(whole.stats.cache_hits.values())


def test_a_change_in_a_callees_file_renews_the_caller(tmp_path: Path) -> None:
    (tmp_path / "callee.py").write_text(CALLEE.format("1.0"))
    (tmp_path / "whole.py").write_text(CALLER)
    assert run(tmp_path) == (4.0, 0)
    assert run(tmp_path) == (4.0, 1)  # kept
    (tmp_path / "callee.py").write_text(CALLEE.format("5.0"))
    assert run(tmp_path) == (12.0, 0)


def test_without_the_stamp_the_old_code_would_run(tmp_path: Path) -> None:
    """The negative control: numba's own cache does not see the callee."""
    plain = "from numba import njit\ncompiled = njit(cache=True)\n"
    (tmp_path / "plain.py").write_text(plain)
    callee = CALLEE.replace("core.compiled", "plain")
    (tmp_path / "callee.py").write_text(callee.format("1.0"))
    (tmp_path / "whole.py").write_text(CALLER.replace("core.compiled", "plain"))
    assert run(tmp_path) == (4.0, 0)
    (tmp_path / "callee.py").write_text(callee.format("5.0"))
    assert run(tmp_path) == (4.0, 1)


def test_the_stamp_is_that_of_the_sources(tmp_path: Path) -> None:
    room = Path(kernel.__file__).parent
    assert kernel.volume_messages._cache._cache_file._source_stamp == stamp_of(room)  # type: ignore[attr-defined]
    (tmp_path / "a.py").write_text("x = 1\n")
    before = stamp_of(tmp_path)
    stamp_of.cache_clear()
    (tmp_path / "a.py").write_text("x = 2\n")
    assert stamp_of(tmp_path) != before


@pytest.fixture(autouse=True)
def _forget() -> None:
    stamp_of.cache_clear()

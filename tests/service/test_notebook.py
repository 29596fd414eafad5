"""The README's notebook, run as it stands against a real server."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.image
import meshio
import numpy as np
import pytest

from service.client import Client
from service.settings import Settings
from tests.service.reading_back import arviz
from tests.service.test_processes import serving

README = Path(__file__).parents[2] / "README.md"
MOST_LINES = 30


def script(name: str = "notebook") -> str:
    found = re.search(rf"<!-- {name} -->\n```python\n(.*?)```", README.read_text(), re.DOTALL)
    assert found is not None
    return found[1]


def test_the_notebook_is_short() -> None:
    assert 15 < script().count("\n") <= MOST_LINES


def test_the_notebook_of_the_readme_runs_as_it_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    matplotlib.use("Agg")
    arviz()
    monkeypatch.chdir(tmp_path)
    database = f"sqlite:///{tmp_path / 'x.db'}"
    settings = Settings(database_url=database, science="fake", sealers=0, diagnosers=0)
    with serving(settings) as (_, client):
        url = str(client._http.base_url)
        # `Client()` leads to port 8000, which may be somebody else's here
        monkeypatch.setattr(Client.__init__, "__defaults__", (url,))
        space: dict[str, Any] = {"__name__": "__main__"}
        exec(compile(script(), "README.md", "exec"), space)
        space["twin"].close()
        picture = matplotlib.image.imread("band.png")
        assert picture.shape[0] > 400
        assert len(np.unique(picture.reshape(-1, 4), axis=0)) > 50, "something is drawn"
        draws = space["draws"].posterior
        assert draws.sizes["draw"] == 2000
        assert draws["blade"].values.tolist() == ["B01", "B02", "B03"]
        own = client.posterior("demo", "B01")["parameters"]["offset"]
        found = draws["offset"].sel(blade="B01")
        assert float(found.mean()) == pytest.approx(own["mean"], abs=0.15 * own["sd"])
        field = client.field("demo", "B01", "ceeq", time_h=24_000)
        assert meshio.read("B01.vtu").point_data["ceeq mean [1]"].tolist() == field["mean"]
        exec(compile(script("frames"), "README.md", "exec"), space)
        space["twin"].close()
        last = space["bands"].iloc[-1]
        assert last["lower"] < last["mean"] < last["upper"]
        assert space["draws"].index.names == ["draw", "blade"]
        assert space["field"]["sd"].dims == ("time_h", "node")
        assert len(matplotlib.pyplot.get_fignums()) >= 4
        told = capsys.readouterr().out
        assert re.search(r"^offset\[B03\] +\S", told, re.MULTILINE)
    matplotlib.pyplot.close("all")
    assert os.listdir(tmp_path)


def test_the_test_of_the_readme_passes() -> None:
    space: dict[str, Any] = {"__name__": "test"}
    exec(compile(script("in memory"), "README.md", "exec"), space)
    space["test_ours"]()

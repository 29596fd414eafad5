"""A network written by hand: read safely, and refused with every fault."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from core.builtin.paper_network import rotor_blade_network
from core.errors import FaultsError, InputError
from core.network import Network
from service.declared import read_network
from tests.exchanger import NETWORK


def faults(text: str) -> dict[str, str]:
    with pytest.raises(FaultsError) as caught:
        read_network(text)
    return {one.what: one.problem for one in caught.value.faults}


def test_yaml_and_json_declare_the_same_network() -> None:
    from_yaml = read_network(NETWORK)
    assert from_yaml.parameter("fouling_rate").prior.low == 2e-5
    assert read_network(json.dumps(from_yaml.to_json())) == from_yaml
    assert from_yaml.quantity("drop").sigma_obs.high == 2.0
    shipped = rotor_blade_network()
    assert read_network(json.dumps(shipped.to_json())) == shipped


def test_every_fault_of_a_declaration_is_told_under_the_name_that_was_written() -> None:
    text = (
        NETWORK.replace("level: local", "level: 3")
        .replace("low: 1, high: 9", "low: one, high: 9, width: 2")
        .replace("unit: kPa, kind: scalar", "kind: skalar")
        .replace("name: fouling_rate", "name: yes")
    )
    found = faults(text)
    assert found == {
        "network.parameters[0].level": "is not a text",
        "network.parameters[0].prior.width": "is not known",
        "network.parameters[0].prior.low": "is not a finite number",
        "network.parameters[1].name": "is not a text",
        "network.quantities[0].unit": "is missing",
        "network.quantities[0].kind": "is not known",
    }


def test_the_network_of_the_readme_is_one() -> None:
    readme = (Path(__file__).parents[2] / "core" / "README.md").read_text()
    text = readme.partition("# network.yaml")[2].partition("```")[0]
    assert read_network("#" + text) == read_network(NETWORK)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name: [", "is neither YAML nor JSON"),
        ("a: &x [1]\nb: *x", "aliases"),
        ("name: a\nname: b", "has name twice"),
        ("!!python/object/apply:os.system ['true']", "is neither YAML nor JSON"),
        ("just words", "is no mapping"),
        ("name: " + "x" * 2**20, "is too long"),
        ("\x00", "is neither YAML nor JSON"),
    ],
)
def test_what_is_no_plain_data_is_refused(text: str, words: str) -> None:
    (problem,) = faults(text).values()
    assert words in problem


def test_what_no_rotor_could_be_calibrated_with_is_refused() -> None:
    """A model was trained, and each of its rotors was blocked, or answered beyond its runs."""
    text = NETWORK.replace("level: shared", "level: known, nominal: 3e-3").replace(
        "kind: uniform, low: 1, high: 9", "kind: log_uniform, low: 1, high: 9"
    )
    assert faults(text) == {
        "network.parameters[0].prior.kind": "cannot be calibrated as an input",
        "network.parameters[1].nominal": "lies outside 2e-05 … 0.0002, which the runs cover",
    }
    known = NETWORK.replace("level: shared", "level: known, nominal: 2e-4")
    assert read_network(known.replace("kind: uniform, low: 2e-5", "kind: log_uniform, low: 2e-5"))


def test_what_the_network_itself_refuses_is_told_as_well() -> None:
    found = faults(NETWORK.replace("low: 1, high: 9", "low: 9, high: 1"))
    assert list(found.values()) == ["are not an interval"]


@pytest.mark.parametrize(
    ("own", "words"),
    [
        ("drifts: [{name: fouling_rate, input: roughness, shape: [[0, 0], [9, 1]], since: 3}]",
         "since of fouling_rate = 3.0 is no mapping"),
        ("drifts: [{name: fouling_rate, input: roughness, shape: [[0, 0], [9, 1]], blades: B07}]",
         "blades of fouling_rate = 'B07' is no list"),
        ("biases: [{name: fouling_rate, quantity: drop, shape: [[0, 1]], since: [B07]}]",
         "since of fouling_rate = ['B07'] is no mapping"),
        ("families: [{name: [dust], sentence: it settles, target: input, of: roughness, how: plus, "
         "size: 1, sign: 0, shapes: [constant], whom: [all], clock: blade, kind: physics}]",
         "name of an effect = ['dust'] is no text"),
    ],
)  # fmt: skip
def test_effects_that_are_none_are_told_and_not_stumbled_over(own: str, words: str) -> None:
    with pytest.raises(FaultsError) as caught:
        read_network(f"{NETWORK}\n{own}\n")
    assert words in str(caught.value)


def test_what_is_no_network_is_refused_by_python_as_well() -> None:
    for spoilt in (
        {"quantities": ["drop"]},
        {"quantities": [{"name": "drop", "discrepancy": 5}]},
        {"parameters": [{"name": "a", "level": "local", "prior": {}, "population": 3}]},
    ):
        told = json.loads(json.dumps(read_network(NETWORK).to_json())) | spoilt
        with pytest.raises(InputError, match="does not fit the schema"):
            Network.from_json(told)

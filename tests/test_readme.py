"""What a user can set, call or ask is in the README."""

from __future__ import annotations

from pathlib import Path

from service.settings import table

README = (Path(__file__).parent.parent / "README.md").read_text()


def test_every_setting_is_named_with_its_default() -> None:
    missing = [
        name
        for name, default, _ in table()
        if f"`{name}` | `{default}`" not in README and f"`{name}` | empty" not in README
    ]
    assert missing == []


def test_the_two_commands_stand_in_the_readme() -> None:
    assert README.count("python3 -m venv") == 2
    assert "<!-- test command -->" in README

"""YAML read safely: plain data alone, from whoever sends it.

No aliases (a few lines could else unfold to gigabytes), no key twice (the last would silently win),
no number longer than `LONGEST_NUMBER` characters, and 1e-3 is a number, as YAML 1.2 has it.
`UNREADABLE` is what reading raises of a text that is none.
"""

from __future__ import annotations

import re
from collections import Counter
from typing import Any

import yaml

from service.names import LONGEST_NUMBER

UNREADABLE = (
    *(yaml.YAMLError, UnicodeDecodeError, ValueError, RecursionError, OverflowError),
    *(KeyError, IndexError, AttributeError, TypeError),  # explicit tags on what they do not fit
)


class PlainReader(yaml.SafeLoader):  # type: ignore[misc]
    """Safe YAML, without aliases and repeated keys, and with the numbers of YAML 1.2."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.events.AliasEvent):
            mark = self.peek_event().start_mark
            raise yaml.YAMLError(
                f"line {mark.line + 1}: aliases (*name) are not read; write it out"
            )
        return super().compose_node(parent, index)

    def short_number(self, node: Any) -> Any:
        if len(node.value) > LONGEST_NUMBER:
            line = node.start_mark.line + 1
            raise yaml.YAMLError(
                f"the number at line {line} has {len(node.value)} characters, above "
                f"{LONGEST_NUMBER}"
            )
        whole = node.tag.endswith(":int")
        return self.construct_yaml_int(node) if whole else self.construct_yaml_float(node)

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        keys = [self.construct_object(key, deep=True) for key, _ in node.value]
        counts = Counter(keys)
        twice = sorted({str(key) for key in keys if counts[key] > 1})
        if twice:
            line = node.start_mark.line + 1
            raise yaml.YAMLError(f"the mapping at line {line} has {', '.join(twice)} twice")
        return super().construct_mapping(node, deep)


PlainReader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?(\d+(\.\d*)?|\.\d+)[eE][-+]?\d+$"),
    list("-+.0123456789"),
)


for _tag in ("int", "float"):
    PlainReader.add_constructor(f"tag:yaml.org,2002:{_tag}", PlainReader.short_number)

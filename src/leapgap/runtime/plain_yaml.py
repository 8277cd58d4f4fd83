"""YAML as plain data of bounded size: no tag makes an object, no key stands twice, and names do not multiply."""

import re
from typing import Any

import yaml

MERGE = "tag:yaml.org,2002:merge"
"""Tag of the key ``<<``."""
NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
LONGEST_NUMBER = 1000
"""Characters of a number."""
MOST_BYTES, MOST_VALUES = 1_000_000, 100_000
"""Size of a file, and values in it, names written out."""


def from_yaml(text: str) -> Any:
    """Values of a YAML text. ``1e-3`` is a number here as everywhere else; PyYAML alone would take it for a text."""
    return yaml.load(text, Loader=Loader)


class Loader(yaml.SafeLoader):
    """Reads plain data and floating-point numbers without a dot, and refuses a key that is there twice."""

    written_out = 0
    """Keys of all mappings so far."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        """The mapping of a node; what ``<<`` brings in may be stated anew."""
        known: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.tag != MERGE:
                if key.value in known:
                    raise yaml.constructor.ConstructorError(None, None, f"the key {key.value} twice", key.start_mark)
                known.add(key.value)
        return super().construct_mapping(node, deep)

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        """Write out what ``<<`` brings in, which may bring in further mappings, each of them several times."""
        super().flatten_mapping(node)
        self.written_out += len(node.value)
        if self.written_out > 2 * MOST_VALUES:  # a mapping that is brought in is counted there, too
            raise yaml.constructor.ConstructorError(None, None, f"more than {MOST_VALUES} values", node.start_mark)

    def construct_scalar(self, node: yaml.ScalarNode) -> Any:
        """The text of a value; a number has few digits (one in base 60, ``1:59``, is computed digit by digit)."""
        if node.tag in NUMBERS and len(node.value) > LONGEST_NUMBER:
            found = f"a number of {len(node.value)} characters"
            raise yaml.constructor.ConstructorError(None, None, found, node.start_mark)
        return super().construct_scalar(node)


Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?[0-9][0-9_]*(\.[0-9_]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)


def check_size(values: Any) -> None:
    """``ValueError`` for more values than settings have, written out; names of YAML stand for what they name.

    ``RecursionError`` for values that contain themselves.
    """
    sizes: dict[int, int] = {}

    def size(value: Any) -> int:
        if not isinstance(value, dict | list):
            return 1
        if id(value) not in sizes:
            inner = value.values() if isinstance(value, dict) else value
            sizes[id(value)] = 1 + sum(map(size, inner))
        return sizes[id(value)]

    if size(values) > MOST_VALUES:
        raise ValueError(f"{size(values):.3g} values; expected at most {MOST_VALUES}")

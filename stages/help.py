"""What ``--help`` of a stage prints: what it does, examples, and its own options with their defaults and units.

The options are those of ``conf/<stage>/default.yaml``; what a comment there says of a key is what is printed of it.
"""

import ast
import re
import textwrap
from collections.abc import Sequence
from pathlib import Path

from leapgap.runtime.output_folder import package_version

CONF = Path(__file__).resolve().parent.parent / "conf"
WIDTH, KEYS = 110, 46  # characters of a line, and of the column of the keys
LONGEST_DEFAULT = 24
LINE = re.compile(r"(?P<indent> *)(?P<key>[\w\"*./-]+):(?: (?P<value>.*))?")


def answered_at_once(name: str, arguments: Sequence[str]) -> str | None:
    """What ``--help`` and ``--version`` print, by the text of a stage's file; None without them.

    So it can be answered before the stage is imported, which takes a second.
    """
    path = Path(__file__).with_name(f"{name}.py")
    if {"--help", "-h"} & set(arguments) and path.is_file():
        return help_text(name, ast.get_docstring(ast.parse(path.read_bytes()), clean=False) or "", CONF)
    return f"leapgap {package_version()}\n" if "--version" in arguments else None


def help_text(name: str, says: str, conf: Path) -> str:
    """The help of a stage; ``says`` is the docstring of its module, with examples."""
    path = conf / name / "default.yaml"
    ends = "Exit code 0: the output is complete. 2: bad input, with one message that says what to do. 130: Ctrl-C."
    if not path.is_file():  # a command that takes words, as its examples show, and no settings
        return f"usage: python -m stages.{name} [word …]\n\n{says.strip()}\n\n{ends}\n"
    parts = [
        f"usage: python -m stages.{name} [key=value …] [-m key=a,b …]",
        says.strip(),
        "Options, with their defaults. Units: m, rad, s, N, N·m, kg unless said otherwise.",
        "\n".join(describe(path.read_text(encoding="utf-8"), name)),
        "Of other sections: robot.model=<model.xml>, executor=local|joblib|ray, executor.workers=<n>, size=tiny.\n"
        "-m runs once for each combination of values. --cfg job prints the whole configuration, --hydra-help more.\n"
        + ends,
    ]
    return "\n\n".join(parts) + "\n"


def describe(text: str, section: str) -> list[str]:
    """A line for each key of a YAML text: the key with its default, and what the comments at it say."""
    lines: list[str] = []
    above: list[str] = []
    parents = [(-1, section)]
    for line in text.splitlines()[1:]:  # the first says what the section is
        content, _, comment = line.partition("#")
        found = LINE.fullmatch(content.rstrip())
        if not content.strip():
            above = [*above, comment.strip()] if comment else []
        elif found is None or found["key"] == "defaults":
            above = []
        else:
            indent, value = len(found["indent"]), found["value"] or ""
            parents = [*((i, key) for i, key in parents if i < indent), (indent, found["key"].strip('"'))]
            key = ".".join(key for _, key in parents)
            shown = value if len(value) <= LONGEST_DEFAULT else value[: LONGEST_DEFAULT - 2].rstrip() + " …"
            says = " ".join([*above, comment.strip()]).strip()
            lines += row(f"{key}={shown}" if value else f"{key}.…", says)
            above = []
    return lines


def row(key: str, says: str) -> list[str]:
    """A key and its explanation in two columns."""
    wrapped = textwrap.wrap(says, WIDTH - KEYS - 2)
    if not wrapped:
        return [f"  {key}"]
    first = [f"  {key}"] if len(key) > KEYS - 3 else []
    lead = "" if first else f"  {key}"
    return [*first, *(f"{(lead if i == 0 else ''):<{KEYS}}{part}".rstrip() for i, part in enumerate(wrapped))]

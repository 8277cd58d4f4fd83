"""Pages of the site that are not written by hand: front page, changelog, command, effects, settings and results.

MkDocs calls the functions ``on_…`` (``hooks`` in mkdocs.yml). What the code can say of itself is asked of it, so that
these pages are never stale. Pages of the research record stay out of the search.
"""

import argparse
import dataclasses
import importlib
import inspect
import re
import sys
import textwrap
import tomllib
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parent.parent
COPIED = {"index.md": "README.md", "research/changelog.md": "CHANGELOG.md"}
"""Page of the site by the file at the project's root that it shows."""
RECORD = ("research/", "contributing/")
"""Folders whose pages the search does not find."""
WIDE = ("reference/effects.md", "explanation/comparison.md")
"""Pages whose tables take the place of the table of contents."""
LINK = re.compile(r"(?P<picture>!?)\[(?P<text>[^\]]*)\]\((?P<target>[^)\s]+)\)")
COMMAND_WIDTH = 80

COMMAND = """# Command

*For users of the command. After this page you know every command and option; made from `leapgap --help`.*

Exit code 0: done. Exit code 2: bad input, with one message that says where, what was found, what was expected and
what to do. Exit code 130: stopped by Ctrl-C. Lengths are in m, angles in rad, times in s, forces in N, torques in N·m.
"""
EFFECTS = """# Effects

*For everybody who reads a report. After this page you know what each effect is, and what its number means.*

`leapgap effects robot.xml` prints the same with the nominal value and the range that is searched on *your* robot. *Own*
is the value that the model file states. *Default*: searched in every diagnosis. *Named*: searched with `--effects`;
[restrict or extend the search](../how-to/choose_effects.md) says how. [Effect signatures](../research/signatures.md)
shows how each looks in a motion. How exactly each is simulated stands in the [research record](../research/effects.md).

<div class="second-wide" markdown>

| effect | what it is | parameter, unit | nominal | acts at | searched |
|---|---|---|---|---|---|
"""
SETTINGS = """# Settings

*For users who want another search or other thresholds. After this page you can change every setting of a diagnosis.*

On the command line they are a JSON or YAML file with what differs (`leapgap diagnose … --settings settings.yaml`), in
Python `lg.Settings(…)`, in the pipeline the section `diagnose.settings`. Made from the dataclasses in the code.

```yaml
bootstrap_draws: 1000        # settings.yaml
sizes: {joint_pos: 0.01}     # rad
outside: {least_size: 5.0}   # a group of settings
```
"""


def page_from_root(text: str, page: str) -> str:
    """A file of the project's root as a page: links into docs/ lead to its pages, other local links become text."""
    up = "../" * page.count("/")

    def replaced(link: re.Match[str]) -> str:
        target = link["target"]
        if target.startswith(("http://", "https://", "#")):
            return link[0]
        if target.startswith("docs/"):
            return f"{link['picture']}[{link['text']}]({up}{target.removeprefix('docs/')})"
        for other, file in COPIED.items():
            if target == file:
                return f"[{link['text']}]({up}{other})"
        return link["text"]

    return LINK.sub(replaced, text)


def command_page() -> str:
    """All commands with their options, as their parsers have them."""
    from leapgap import cli

    parts = [COMMAND]
    (commands,) = (action for action in cli.parser()._actions if isinstance(action, argparse._SubParsersAction))
    for name, parser in commands.choices.items():
        parser.formatter_class = lambda prog: argparse.RawDescriptionHelpFormatter(
            prog, width=COMMAND_WIDTH, max_help_position=26
        )
        text = parser.format_help().replace(cli.UNITS, "").strip()
        parts.append(f"## leapgap {name}\n\n``` {{ .text .as-it-is }}\n{text}\n```\n")
    return "\n".join(parts)


def effects_page() -> str:
    """One row for each parameter of each effect."""
    from leapgap import effects

    rows = []
    for name, kind in effects.known().items():
        called = " ".join(f"`{one}`" for one in (name, *kind.other_names))
        places = {"none": "the robot"}.get(kind.places, kind.places)
        when = "default" if kind.by_default else "uneven time stamps" if kind.beside_clock else "named"
        what = effects.describe(kind)
        detail = " ".join((inspect.getdoc(kind) or "").split("\n\n")[0].split()).replace("|", "\\|").replace("``", "`")
        for parameter, about in kind.declarations().items():
            nominal = "own" if about.nominal is None else f"{about.nominal:g}"
            unit = "" if about.unit == "1" else f", {about.unit}"
            said = f"**{what[:1].upper()}{what[1:]}.** {detail}" if called else ""
            rows.append(f"| {called} | {said} | `{parameter}`{unit} | {nominal} | {places} | {when} |")
            called = ""
    return EFFECTS + "\n".join(rows) + "\n\n</div>\n"


def settings_page() -> str:
    """All settings of a diagnosis, a table for each of their dataclasses."""
    from leapgap.diagnosis.settings import Settings

    parts, waiting = [SETTINGS], [("", Settings)]
    while waiting:
        group, kind = waiting.pop(0)
        says = documented_fields(kind)
        rows = []
        for one in dataclasses.fields(kind):
            default = one.default if one.default is not dataclasses.MISSING else one.default_factory()  # type: ignore[misc]
            if dataclasses.is_dataclass(default):
                waiting.append((f"{group}{one.name}", type(default)))
                default = f"[group](#{one.name})"
            else:
                default = (
                    f"`{default}`" if not isinstance(default, dict) or len(default) < 3 else "see `leapgap.Settings()`"
                )
            rows.append(f"| `{one.name}` | {default} | {says.get(one.name, '')} |")
        head = f"\n## {group}\n" if group else "\n## All settings\n"
        parts.append(f"{head}\n| setting | default | meaning |\n|---|---|---|\n" + "\n".join(rows) + "\n")
    return "\n".join(parts)


def documented_fields(kind: type) -> dict[str, str]:
    """Text below each field of a dataclass, by the field's name."""
    import ast

    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    assert isinstance(tree, ast.ClassDef)
    found = {}
    for before, node in zip(tree.body, tree.body[1:], strict=False):
        is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if is_text and isinstance(before, ast.AnnAssign) and isinstance(before.target, ast.Name):
            text = " ".join(str(node.value.value).split())  # type: ignore[attr-defined]
            found[before.target.id] = text.replace("``", "`").replace("|", "\\|")
    return found


def results_page() -> str:
    """All figures of the committed metrics as a page, with charts and the code that made them.

    What links into data/ is left out.
    """
    from leapgap.jumping.reports.results_index import markdown, sections

    sys.path.insert(0, str(ROOT))  # mkdocs as a program does not look for modules here
    made_with = importlib.import_module("stages.made_with").markdown
    return f"{markdown(sections(ROOT))}\n{made_with(ROOT)}"


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """State the version in the title of the site."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    config.site_name = f"{project['name']} {project['version']}"
    config.copyright = f"{project['name']} {project['version']}, licence {project['license']}"
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages to those of docs/."""
    for page, file in COPIED.items():
        text = page_from_root((ROOT / file).read_text(encoding="utf-8"), page)
        files.append(File.generated(config, page, content=text))
    generated: dict[str, Any] = {
        "reference/command.md": command_page,
        "reference/effects.md": effects_page,
        "reference/settings.md": settings_page,
        "research/results.md": results_page,
    }
    for page, content in generated.items():
        files.append(File.generated(config, page, content=content()))
    return files


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Leave pages of the research record out of the search."""
    if page.file.src_uri.startswith(RECORD):
        page.meta["search"] = {"exclude": True}
    if page.file.src_uri == "index.md":
        page.meta["hide"] = ["navigation"]
    if page.file.src_uri in WIDE:
        page.meta["hide"] = ["toc"]
    return markdown

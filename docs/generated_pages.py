"""Pages of the site that are not written by hand: front page, changelog, and an API page for every package.

MkDocs calls the functions ``on_…`` (``hooks`` in mkdocs.yml). The API pages follow the package tree, so that a module
that moves needs no edit here.
"""

import re
import sys
from pathlib import Path, PurePosixPath
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parent.parent
SOURCE = ROOT / "src"
PACKAGE = "leapgap"
COPIED = {"index.md": "README.md", "changelog.md": "CHANGELOG.md"}
"""Page of the site by the file at the project's root that it shows."""
LINK = re.compile(r"(?P<picture>!?)\[(?P<text>[^\]]*)\]\((?P<target>[^)\s]+)\)")


def packages(source: Path = SOURCE, package: str = PACKAGE) -> dict[str, list[str]]:
    """Public modules of every package, in alphabetical order; a package inside another has its own entry."""
    found: dict[str, list[str]] = {}
    for init in sorted((source / package).rglob("__init__.py")):
        folder = init.parent
        name = ".".join(folder.relative_to(source).parts)
        modules = sorted(path.stem for path in folder.glob("*.py") if not path.stem.startswith("_"))
        found[name] = [f"{name}.{module}" for module in modules]
    return found


def api_page(package: str, modules: list[str]) -> str:
    """Markdown of one package: what its ``__init__`` says and has, then its modules."""
    blocks = [f"::: {package}\n    options:\n      show_root_heading: false\n      show_root_toc_entry: false\n"]
    blocks += [f"::: {module}\n" for module in modules]
    return f"# {package}\n\n" + "\n".join(blocks)


def page_from_root(text: str) -> str:
    """A file of the project's root as a page: links into docs/ lead to its pages, other local links become text."""

    def replaced(link: re.Match[str]) -> str:
        target = link["target"]
        if target.startswith(("http://", "https://", "#")):
            return link[0]
        if target.startswith("docs/"):
            return f"{link['picture']}[{link['text']}]({target.removeprefix('docs/')})"
        for page, file in COPIED.items():
            if target == file:
                return f"[{link['text']}]({page})"
        return link["text"]

    return LINK.sub(replaced, text)


def api_path(package: str) -> str:
    """Where the page of a package stands in the site."""
    return str(PurePosixPath("api") / f"{package}.md")


def results_page() -> str:
    """All figures of the committed metrics as a page, with charts and the code that made them.

    What links into data/ is left out.
    """
    from leapgap.jumping.reports.results_index import markdown, sections

    sys.path.insert(0, str(ROOT))  # mkdocs as a program does not look for modules here
    from stages.made_with import markdown as made_with

    return f"{markdown(sections(ROOT))}\n{made_with(ROOT)}"


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Append the API reference to the navigation."""
    pages: list[dict[str, str]] = [{package: api_path(package)} for package in packages()]
    nav: list[Any] = [*(config.nav or []), {"API reference": pages}]
    config.nav = nav
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages to those of docs/."""
    for page, file in COPIED.items():
        text = page_from_root((ROOT / file).read_text(encoding="utf-8"))
        files.append(File.generated(config, page, content=text))
    files.append(File.generated(config, "results.md", content=results_page()))
    for package, modules in packages().items():
        files.append(File.generated(config, api_path(package), content=api_page(package, modules)))
    return files

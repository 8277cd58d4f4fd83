"""What the code of each stage means, as one small file of hashes a stage: what DVC depends on in place of source files.

A file names every module that a stage comes to import, with a hash of its syntax tree without comments and docstrings,
and the data files that these modules read. So a comment reruns nothing. DVC runs this stage each time.

Examples:

    python -m stages.code
"""

import json
from collections.abc import Iterable
from pathlib import Path

from leapgap.errors import InputError
from leapgap.runtime.atomic_io import read_json, write_text
from leapgap.runtime.import_closure import PACKAGE, SourceTree

OUT = Path("data/code")
STAGES = Path(__file__).parent
PAGES = ("leapgap.reports", "leapgap.jumping.reports")  # packages whose modules make pages and recordings
COMPUTING = ("diagnosis", "kept", "verdict_jobs", "revisits", "real_robots")
COMPUTES = {"leapgap.reports", *(f"leapgap.reports.{name}" for name in COMPUTING)}
"""What of them is used without a page."""
GUARDS = "leapgap.runtime"  # what guards a run and shapes no result: `stages/__init__.py` loads it before any stage
RENDERS = {"evaluate", "index", "land_page", "report", "score", "view"}
"""Stages that make pages; of the others no module of ``PAGES`` counts, and ``check_loaded`` holds them to it."""
RUNS = "run_stage("  # what the file of a stage calls, and of another command does not


def hashes(name: str, tree: SourceTree) -> dict[str, str]:
    """Hash of each module and data file that a stage depends on."""
    if name in RENDERS:
        return tree.hashes(f"stages.{name}")
    pages = {one for one in tree.modules if one.startswith(PAGES)} - COMPUTES
    return {key: of for key, of in tree.hashes(f"stages.{name}", without=pages).items() if not key.endswith(".html")}


def write_hashes(out: Path) -> None:
    """Write the file of each stage; one that says the same already is not touched."""
    tree = SourceTree((PACKAGE, STAGES))
    for name in stage_modules():
        text, file = json.dumps(hashes(name, tree), indent=1) + "\n", out / f"{name}.json"
        if not file.is_file() or file.read_text(encoding="utf-8") != text:
            write_text(file, text)


def stage_modules() -> list[str]:
    """Names of the modules that are stages."""
    texts = {path.stem: path.read_text(encoding="utf-8") for path in STAGES.glob("*.py")}
    return sorted(name for name, text in texts.items() if name == "params" or RUNS in text.partition('"__main__":')[2])


def check_loaded(name: str, loaded: Iterable[str]) -> None:
    """Raise ``InputError`` where a stage has loaded code of ours that its file of hashes does not name."""
    path = OUT / f"{name}.json"
    if not path.is_file():
        return
    ours = {one for one in loaded if one.startswith(("leapgap.", "stages.")) and not one.startswith(GUARDS)}
    if missing := sorted(ours - set(read_json(path))):
        do = "let the stage do without it, or name the stage in RENDERS of stages/code.py"
        raise InputError(path, f"no {', '.join(missing)}", "all code that the stage has loaded", do)


if __name__ == "__main__":
    write_hashes(OUT)

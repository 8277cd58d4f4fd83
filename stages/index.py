"""The index of all results as one page: figures, commands that make them again, sentences, links.

Examples:

    python -m stages.index index.out=data/index.html
"""

from pathlib import Path

from omegaconf import DictConfig

from leapgap.errors import InputError
from leapgap.jumping.reports import results_index
from leapgap.runtime.atomic_io import write_text
from stages.common import run_folder, run_stage

TITLE = "<title>leapgap: all results</title>"  # line by which an index of ours is known from a page of somebody else's


def index(config: DictConfig) -> None:
    """Write the page; what is absent is said on it."""
    section = config.index
    out = Path(section.out) if section.out else run_folder() / "index.html"
    if out.exists() and (not out.is_file() or TITLE not in out.read_text(encoding="utf-8", errors="replace")[:1000]):
        raise InputError(out, "a file that this stage did not write", "an index of ours, or none", "name another file")
    root = Path(section.root)
    if not root.is_dir():
        raise InputError("index.root", f"{root}, which is no folder", "the folder of the project", "name it")
    parts = results_index.sections(root, section.published)
    write_text(out, results_index.html(parts))
    for part in parts:
        if part.absent:
            print(f"{part.source.title}: not there, {part.source.command} makes it")
    print(f"all results: {out}")


if __name__ == "__main__":
    run_stage(index)

"""What a saved report holds, as lines for a person."""

from collections.abc import Iterator
from pathlib import Path

from leapgap.reports.diagnosis import BEST, CORRECTED, PAGE, RECORDING, REPORT
from leapgap.runtime.atomic_io import read_json
from leapgap.simulation.corrected import MODEL, NOMINAL, PARAMETERS
from leapgap.simulation.corrected_readme import placed_in_words

HOLDS = {
    PAGE: "the report to read in a browser",
    REPORT: "the same as data",
    RECORDING: "one log and its replays, for the Rerun viewer",
    CORRECTED: "the model with the identified causes",
    BEST: "the model with every number fitted: for prediction, not for explanation",
}
"""What each file and folder of a report holds."""


def what_was_written(folder: Path) -> list[str]:
    """What a report's folder holds, and of each identified effect where it is."""
    names = [name for name in HOLDS if (folder / name).exists()]
    width = max((len(name) for name in names), default=0)
    return [f"written to {folder}:", *(f"  {name:<{width}}  {HOLDS[name]}" for name in names), *effects_of(folder)]


def effects_of(folder: Path) -> Iterator[str]:
    """Of each effect in ``corrected`` where it is, and which model file could not be written."""
    corrected = folder / CORRECTED
    if not (corrected / PARAMETERS).is_file():
        return
    missing = [name for name in (MODEL, NOMINAL) if not (corrected / name).is_file()]
    for name in missing:
        yield f"  no {CORRECTED}/{name}: {CORRECTED}/README.md says why"
    for line in placed_in_words(read_json(corrected / PARAMETERS), missing):
        yield f"  {line}"

"""A report kept as data, so that its page, its recording and its replays can be written, and written anew, later.

It is a pickle of what those need, for the pipeline that wrote it and for nobody else: a pickle of a stranger can do
anything when it is read.
"""

import pickle
import shutil
from dataclasses import replace
from pathlib import Path

from leapgap.errors import InputError
from leapgap.reports.diagnosis import BEST, CORRECTED, REPORT, Report
from leapgap.runtime.atomic_io import whole_file, write_text

KEPT = "report.pickle"


def keep(report: Report, folder: Path) -> None:
    """Write the data of a report into a folder, and what its page is made from."""
    report.write_data(folder)
    with whole_file(folder / KEPT) as beside:
        bare = replace(report.diagnosis, nominal={}, corrected={}, fit=None)
        with beside.open("wb") as file:
            writer = pickle.Pickler(file, protocol=4)
            writer.fast = True  # equal reports give equal bytes, whichever of their parts are one object
            writer.dump(replace(report, diagnosis=bare, record=None))


def kept(folder: Path) -> Report | None:
    """The report that is kept in a folder; None where there were no logs to diagnose."""
    path = folder / KEPT
    if not folder.is_dir():
        raise InputError(folder, "no such folder", "a diagnosis that was kept", "run stages.diagnose with pages=false")
    if not path.is_file():
        return None
    found = pickle.loads(path.read_bytes())
    assert isinstance(found, Report)
    return found


def copy_data(folder: Path, out: Path) -> None:
    """Copy the data of a kept report into the folder of its page."""
    shutil.copyfile(folder / REPORT, out / REPORT)
    for name in (CORRECTED, BEST):
        if (folder / name).is_dir():
            shutil.copytree(folder / name, out / name)


def write_note(folder: Path) -> None:
    """Write that there were no logs."""
    write_text(folder / "no_logs.txt", "There were no jump logs to diagnose.\n")

"""Recordings of all results of the pipeline: which folders are shown, and in which form."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from leapgap.errors import InputError
from leapgap.jumping.reports import references
from leapgap.jumping.reports.method_comparison import comparison_logs, record_comparison
from leapgap.jumping.reports.prediction import record_prediction
from leapgap.logs.log import Log, read_log
from leapgap.reports.log_recording import DIAGNOSED, GHOSTS, JUDGED, record_jump
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import read_json, write_text


@dataclass(frozen=True)
class View:
    """Section ``view`` of the configuration; folders that are missing or empty are skipped, and those that are None."""

    references: str | None
    simulated: str | None
    damped: str | None
    published: str | None
    replays_damped: str
    replays_published: str
    predictions_simulated: str
    predictions_published: str
    most: int
    """Largest number of recordings of each kind; the first by name are taken."""
    most_predictions: int
    """Largest number of jumps with predictions of each kind; the first by name are taken."""
    most_landings: int
    """Largest number of tasks whose landings are recorded."""
    models: list[str]
    """Models whose predictions are shown; empty: all."""
    landings: str | None
    """Folder of the runs of one robot, as stage ``land`` keeps them."""
    landing_methods: list[str]
    """Methods shown in one scene, the first solid, the others as ghosts."""
    out: str | None = None

    def __post_init__(self) -> None:
        counts = {"most": self.most, "most_predictions": self.most_predictions, "most_landings": self.most_landings}
        if min(counts.values()) < 0:
            raise ValueError(f"{', '.join(f'{name} {count}' for name, count in counts.items())}: 0 or more")


def record_all(view: View, robot: Robot, out: Path) -> Iterator[str]:
    """Write every recording into ``out``; yields one line for each kind: what was written or skipped."""
    if view.references is not None:
        index = Path(view.references) / "references.json"
        if index.is_file():
            write_text(out / "references.html", references.html(index.parent, robot))
        yield describe_recordings("references.html", view.references, int(index.is_file()), 1)
    for kind, label, folder, replays in (
        ("reference", "reference", view.references, None),
        ("simulated", "simulated", view.simulated, None),
        ("damped", "simulated", view.damped, view.replays_damped),
        ("published", "measured", view.published, view.replays_published),
    ):
        if folder is None:
            continue
        logs = logs_in(Path(folder))
        for path in islice(logs, view.most):
            jump = as_judged(path, replays)
            record_jump(
                out / f"{kind}_{jump.name}.rrd",
                jump,
                robot,
                ghosts_of(jump, replays),
                title=f"{kind} {jump.name}",
                label=label,
            )
        yield describe_recordings(kind, folder, len(logs), view.most)
    for kind, folder, logs_folder in (
        ("damped", view.replays_damped, view.damped),
        ("published", view.replays_published, view.published),
    ):
        if logs_folder is None:
            continue
        path = Path(folder) / DIAGNOSED
        if path.exists():
            shown = read_json(path)
            jump = as_judged(Path(logs_folder) / f"{shown['log']}.parquet", folder)
            record_jump(
                out / f"diagnosis_{kind}.rrd",
                jump,
                robot,
                ghosts_of(jump, folder),
                title=f"diagnosis of {kind} {jump.name}",
                says=shown["sentence"],
            )
        yield describe_recordings(f"diagnosis_{kind}", folder, int(path.exists()), 1)
    for kind, folder, of_jumps in (
        ("simulated", view.predictions_simulated, view.simulated),
        ("published", view.predictions_published, view.published),
    ):
        if of_jumps is None:
            continue
        tables = logs_in(Path(folder))
        for path in islice(tables, view.most_predictions):
            jump = predicted_jump(path, Path(of_jumps))
            record_prediction(
                out / f"prediction_{kind}_{jump.name}.rrd",
                jump,
                robot,
                path,
                title=f"predictions of {kind} {jump.name}",
                shown=view.models or None,
            )
        yield describe_recordings(f"prediction_{kind}", folder, len(tables), view.most_predictions)
    if view.landings is None or view.references is None:
        return
    found = comparison_logs(Path(view.landings), view.landing_methods)
    for task, logs in islice(found.items(), view.most_landings):
        record_comparison(out / f"landing_{task}.rrd", task, logs, robot, Path(view.references))
    yield describe_recordings("landing", view.landings, len(found), view.most_landings)


def logs_in(folder: Path) -> list[Path]:
    """Parquet files of a folder, sorted by name; none where the folder does not exist."""
    return sorted(folder.glob("*.parquet"))


def as_judged(path: Path, replays: str | None) -> Log:
    """The jump of a file, by its own clock where a folder of replays has it so: its ghosts are by that clock."""
    judged = None if replays is None else Path(replays) / JUDGED / path.name
    return read_log(judged if judged is not None and judged.is_file() else path)


def ghosts_of(jump: Log, replays: str | None) -> dict[str, Log]:
    """The simulated versions of a jump that a folder of replays has."""
    if replays is None:
        return {}
    found = {name: Path(replays) / kind / f"{jump.name}.parquet" for kind, name in GHOSTS.items()}
    return {name: read_log(path) for name, path in found.items() if path.is_file()}


def predicted_jump(predictions: Path, jumps: Path) -> Log:
    """The jump log that a table of predictions belongs to."""
    log = jumps / predictions.name
    if not log.is_file():
        raise InputError(
            predictions, f"no jump log {log}", "a log of the same name", "predict jumps of that folder again"
        )
    return read_log(log)


def describe_recordings(kind: str, folder: str, there: int, most: int) -> str:
    """One line on a kind of recording: how many were written, skipped or left out."""
    if not there:
        return f"{kind}: nothing in {folder}, skipped"
    left = f", {there - most} more not shown" if there > most else ""
    return f"{kind}: {min(there, most)} from {folder}{left}"

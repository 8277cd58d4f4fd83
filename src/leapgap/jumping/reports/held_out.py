"""How well models predict, written whole: metrics, predictions, tables for plots, and a page."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from leapgap.jumping.learning import evaluation, store, time_grid_comparison, window_extraction, windows
from leapgap.jumping.learning.evaluation import HeldOutPredictions
from leapgap.jumping.learning.time_grid_comparison import RollOut
from leapgap.jumping.reports import learning as page
from leapgap.logs.log import read_logs
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import read_json, write_json, write_metrics, write_text
from leapgap.runtime.output_folder import whole_folder

METRICS = "learning.json"


@dataclass
class EvaluateSettings:
    """Section ``evaluate`` of the configuration: models, windows and output files."""

    models: str
    windows: str
    fixed_models: str | None = None
    fixed_windows: str | None = None
    metrics: str | None = None
    timing: str | None = None
    logs: str | None = None
    out: str | None = None

    @property
    def inputs(self) -> tuple[str | None, ...]:
        """Folders that are read."""
        return self.models, self.windows, self.fixed_models, self.fixed_windows, self.logs


def evaluate_held_out(settings: EvaluateSettings, out: Path, by: str) -> dict[str, float] | None:
    """Write metrics and predictions of the jumps that models did not see; cross-validated errors by model.

    ``by``: the command that writes. Without logs a note says so, and metrics that are there already are kept.
    """
    models, extracted = Path(settings.models), windows.read(Path(settings.windows))
    metrics = Path(settings.metrics) if settings.metrics else out / METRICS
    if not len(extracted):
        with whole_folder(out, by) as folder:
            write_json(folder / "note.json", {"note": "no logs: nothing was predicted"})
            if not settings.metrics:
                write_json(folder / METRICS, {"jumps": 0})
        print(f"no logs: {metrics} kept" if settings.metrics and metrics.exists() else f"no logs: {metrics} says so")
        if not metrics.exists():
            write_json(metrics, {"jumps": 0})
        return None
    folds, sessions = (evaluation.predict_held_out(extracted, models, prefix) for prefix in ("fold", "session"))
    figures = evaluation.metrics(folds, sessions, extracted)
    roll_outs = None if folds is None else compare_time_grids(folds, settings)
    if roll_outs is not None:
        figures["landing_rms"] = time_grid_comparison.landing_rms(roll_outs)
    with whole_folder(out, by) as folder:
        if folds is None:
            write_json(folder / "note.json", {"note": "one jump: none could be held out"})
        else:
            evaluation.write_predictions(folds, folder)
            evaluation.write_error_by_step(folds, folder / "error_by_step.csv")
            evaluation.write_calibration(folds, folder / "calibration.csv")
            seconds = read_json(Path(settings.timing))["fit_seconds"] if settings.timing else {}
            about = read_json(Path(settings.windows) / "windows.json")
            text = page.html(figures, seconds, about, models / "curves.csv", folder, roll_outs)
            write_text(folder / "report.html", text)
        if not settings.metrics:
            write_json(folder / METRICS, figures)
    if settings.metrics:
        write_metrics(metrics, figures)
    print(f"{len(extracted)} windows of {len(extracted.jumps)} jumps predicted -> {metrics}, {out}")
    errors: Any = figures.get("cv_mse")
    return {name: float(value) for name, value in errors.items()} if isinstance(errors, dict) else None


def compare_time_grids(folds: HeldOutPredictions, settings: EvaluateSettings) -> dict[str, RollOut] | None:
    """Roll-outs from 650 ms on variable and on fixed steps; None without models of fixed steps."""
    if settings.fixed_models is None or settings.fixed_windows is None:
        return None
    of_fixed, models = windows.read(Path(settings.fixed_windows)), Path(settings.fixed_models)
    fixed = evaluation.predict_held_out(of_fixed, models, "fold")
    return None if fixed is None else time_grid_comparison.compare(folds, fixed)


def evaluate_logs(settings: EvaluateSettings, robot: Robot, out: Path, by: str) -> None:
    """Evaluate the models trained on all jumps on other logs; warn about jumps that they were trained on."""
    models, logs = Path(settings.models), Path(str(settings.logs))
    name = read_json(models / "splits.json")["all"]["models"][0]
    model = store.load(models / "all", name)
    extracted = window_extraction.cut(read_logs(logs), model.purpose.grid, robot)
    mse = evaluation.errors_on_other_jumps(extracted, models) if len(extracted) else {}
    with whole_folder(out, by) as folder:
        write_json(folder / METRICS, {"jumps": len(extracted.jumps), "windows": len(extracted), "mse": mse})
    seen = set(extracted.jumps) & set(model.trained_on)
    if seen:
        print(f"{len(seen)} of these jumps bear names of jumps the models were trained on: no test of them")
    print(f"{len(extracted.jumps)} jumps judged -> {out / METRICS}" if mse else f"no logs in {logs}")

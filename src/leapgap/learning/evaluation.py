"""How well models predict: cross-validated errors, and held-out predictions for people to look at."""

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from leapgap.errors import InputError
from leapgap.files import read_json, whole_file
from leapgap.learning.experiment import FORECAST
from leapgap.learning.model import squared_errors
from leapgap.learning.store import load
from leapgap.recording.windows import Purpose, Windows
from leapgap.robot.rigid_body import STATE

MEASURED = "measured"
WITHOUT_FUTURE = ("constant_velocity", "playback")
"""Models that look at neither measured future feet nor forces, in both protocols then, as forecasts do in theirs."""


@dataclass(frozen=True)
class HeldOut:
    """Predictions of every window by the models that did not see its jump."""

    windows: Windows
    states: Mapping[str, np.ndarray]
    """By model, (W, K + 1, 6)."""

    def error_by_jump(self, model: str) -> np.ndarray:
        """Mean square over a jump's windows, steps and six components, of the jumps predicted, (H,)."""
        error = squared_errors(self.states[model], self.windows).mean(axis=(1, 2))
        known = np.isfinite(error)
        return np.array([error[self.windows.jump == j].mean() for j in np.unique(self.windows.jump[known])])


def held_out(windows: Windows, folder: Path, prefix: str) -> HeldOut | None:
    """Predict each jump with the models of the split (of those named ``prefix``…) that held it out.

    ``None`` where there are no such splits. Models for another grid, schedule or robot are an ``InputError``.
    """
    found = read_json(folder / "splits.json")
    splits = {name: split for name, split in found.items() if name.startswith(prefix)}
    if not splits:
        return None
    states = {model: np.full_like(windows.state, np.nan) for split in splits.values() for model in split["models"]}
    for name, split in splits.items():
        missing = sorted(set(split["held_out"]) - set(windows.jumps))
        if missing:
            raise InputError(
                folder, f"models of {name} for {', '.join(missing)}", "models of these windows", "run stages.train anew"
            )
        which = np.isin(windows.jump, [windows.jumps.index(jump) for jump in split["held_out"]])
        mine = windows.of_jumps(split["held_out"])
        for model in states:
            stored = load(folder / name, model)
            stored.purpose.require(Purpose.of(windows), folder / name / f"{model}.json")
            if set(stored.trained_on) & set(split["held_out"]):
                raise InputError(
                    folder / name / f"{model}.json",
                    "a held-out jump among those trained on",
                    "none",
                    "run stages.train anew",
                )
            inputs = mine.inputs
            states[model][which] = stored.model.predict(inputs.without_measured_future if is_forecast(model) else inputs)
    return HeldOut(windows, states)


def metrics(folds: HeldOut | None, sessions: HeldOut | None, windows: Windows) -> dict[str, object]:
    """The figures of metrics/…/learning.json; errors are mean squares over mixed SI units, as published."""
    found: dict[str, object] = {"jumps": len(windows.jumps), "windows": len(windows)}
    if folds is not None:
        errors = {model: folds.error_by_jump(model) for model in folds.states}
        shown = {model: error for model, error in errors.items() if not is_forecast(model)}
        found["cv_mse"] = {model: rounded(error.mean()) for model, error in shown.items()}
        found["cv_mse_se"] = {model: rounded(standard_error(error)) for model, error in shown.items()}
        blind = {m.removesuffix(FORECAST): e for m, e in errors.items() if m in WITHOUT_FUTURE or is_forecast(m)}
        found["forecast_cv_mse"] = {model: rounded(error.mean()) for model, error in blind.items()}
        found["forecast_cv_mse_se"] = {model: rounded(standard_error(error)) for model, error in blind.items()}
    if sessions is not None:
        found["cv_mse_sessions"] = {
            model: rounded(sessions.error_by_jump(model).mean()) for model in sessions.states if not is_forecast(model)
        }
    return found


def of_unseen(windows: Windows, folder: Path, split: str = "all") -> dict[str, float]:
    """Mean square error of each model of a split on windows of other jumps, by the model's name."""
    found = {}
    for model in read_json(folder / "splits.json")[split]["models"]:
        stored = load(folder / split, model)
        stored.purpose.require(Purpose.of(windows), folder / split / f"{model}.json")
        if not is_forecast(model):
            found[model] = rounded(squared_errors(stored.model.predict(windows.inputs), windows).mean())
    return found


def is_forecast(model: str) -> bool:
    """Whether a model is judged without measured future feet and forces."""
    return model.endswith(FORECAST)


def standard_error(error: np.ndarray) -> float:
    """Of the mean over jumps."""
    return float(error.std(ddof=1) / np.sqrt(len(error)))


def rounded(value: float) -> float:
    """To six significant digits."""
    return float(f"{value:.6g}")


def write_predictions(found: HeldOut, folder: Path) -> None:
    """One Parquet file a jump, in long form, world values: model, window, step, time, and the six components."""
    windows = found.windows
    samples = windows.state.shape[1]
    for number, jump in enumerate(windows.jumps):
        mine = windows.jump == number
        blocks = {MEASURED: windows.state, **found.states}
        count = int(mine.sum())
        columns: dict[str, np.ndarray | list[str]] = {
            "model": np.repeat(list(blocks), count * samples).tolist(),
            "window": np.tile(np.repeat(windows.start[mine], samples), len(blocks)),
            "step": np.tile(np.arange(samples), count * len(blocks)),
            "time": np.tile(windows.time_s[mine].ravel(), len(blocks)),
        }
        for i, name in enumerate(STATE):
            offset = windows.start_x[mine, None] if name == "x" else 0.0
            columns[name] = np.concatenate([(states[mine][..., i] + offset).ravel() for states in blocks.values()])
        with whole_file(folder / f"{jump}.parquet") as beside:
            pq.write_table(pa.table(columns), beside, compression="zstd")


def write_error_by_step(found: HeldOut, path: Path) -> None:
    """Root mean square error over all windows: model, component, step, rms, as CSV."""
    with whole_file(path) as beside, beside.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["model", "component", "step", "rms"])
        for model, states in found.states.items():
            rms = np.sqrt(squared_errors(states, found.windows).mean(axis=0))
            for i, name in enumerate(STATE):
                writer.writerows([model, name, k + 1, f"{value:.6g}"] for k, value in enumerate(rms[:, i]))

"""All models on all splits: fitted where they are not in the cache, kept where they are."""

import csv
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.cache import ResultCache, result_key
from leapgap.errors import InputError
from leapgap.files import read_json, whole_file, write_json
from leapgap.learning import export
from leapgap.learning.experiment import BLENDED, FITS, FORECAST, NO_PHASE, Task, TrainConfig, fit_spread
from leapgap.learning.splits import Split, everything, folds, sessions
from leapgap.learning.store import Stored, load, save
from leapgap.recording.windows import ARRAYS, Purpose, Windows, read_npz

EXPORTED = "exported"
"""Folder of the models fitted on all jumps as others read them: ``control.exported``, ONNX."""
NOT_EXPORTED = (FORECAST, "constant_velocity", "playback")
"""No models of how forces move the base."""
CURVES, SPLITS, NOTE = "curves.csv", "splits.json", "note.json"


def train(
    windows: Windows, config: TrainConfig, out: Path, progress: Callable[[str], None] = lambda _: None
) -> list[str]:
    """Fit every model on every split into ``<out>/<split>/<model>``; the names of what had to be fitted.

    A model whose data, settings and code are unchanged is kept; models nobody asked for are removed. Beside them:
    ``splits.json``, and ``curves.csv`` of those that were trained in steps.
    """
    unknown = [name for name in config.models if name not in FITS]
    if unknown:
        raise InputError("train.models", ", ".join(unknown), f"some of {', '.join(FITS)}", "correct conf/train")
    out.mkdir(parents=True, exist_ok=True)
    cache = ResultCache(out)
    if not len(windows):
        cache.sweep()
        for name in (CURVES, SPLITS):
            (out / name).unlink(missing_ok=True)
        write_json(out / NOTE, {"note": "no logs: nothing was trained"})
        return []
    (out / NOTE).unlink(missing_ok=True)
    splits = [
        *folds(windows.jumps, config.folds),
        *sessions(windows.jumps, config.sessions or []),
        everything(windows.jumps),
    ]
    jobs = [SplitJob(windows, config, split, keys_of(windows, split, config), cache) for split in splits]
    for place, key in [pair for job in jobs for pair in job.places()] + exports(jobs[-1]):
        cache.expect(place, key)
    cache.sweep()
    fitted: list[str] = []
    for number, done in enumerate(each(jobs, config.processes)):
        fitted += done
        progress(f"{splits[number].name} ({number + 1} of {len(splits)}): {len(done)} models fitted")
    write_json(
        out / SPLITS,
        {
            split.name: {"models": config.models_of(split), "train": split.train, "held_out": split.held_out}
            for split in splits
        },
    )
    export_models(jobs[-1])
    write_all_curves(out, {split.name: config.models_of(split) for split in splits})
    return fitted


@dataclass(frozen=True)
class SplitJob:
    """All models of one split."""

    windows: Windows
    config: TrainConfig
    split: Split
    keys: dict[str, str]
    """By model."""
    cache: ResultCache

    @property
    def spread_keys(self) -> dict[str, str]:
        """Keys of the learned errors, by the variant of the kernel whose errors they are."""
        return {
            variant: result_key(fit_spread, self.keys[f"kernel{variant}"])
            for variant in spread_variants(self.config, self.split)
        }

    def places(self) -> list[tuple[str, str]]:
        """Places and keys of all results."""
        models = [(f"{self.split.name}/{name}", key) for name, key in self.keys.items()]
        return models + [(spread_name(self.split, variant), key) for variant, key in self.spread_keys.items()]

    def run(self) -> list[str]:
        """Fit what is not in the cache; the names of what was fitted."""
        fitted = []
        train_on, held_out = (self.windows.of_jumps(jumps) for jumps in (self.split.train, self.split.held_out))
        for name, key in self.keys.items():
            place = f"{self.split.name}/{name}"
            if self.cache.get(place, key) is None:
                with self.cache.store(place, key) as folder:
                    task = Task(
                        self.config,
                        self.split,
                        name,
                        train_on,
                        held_out,
                        self.cache.folder / self.split.name,
                        self.cache.scratch(place, key),
                    )
                    model, curve = FITS[name](task)
                    write_json(folder / f"{name}.curve.json", {"rows": curve})
                    save(Stored(model, Purpose.of(self.windows), self.split.train, key), folder, name)
                fitted.append(place)
        for variant, key in self.spread_keys.items():
            place = spread_name(self.split, variant)
            if self.cache.get(place, key) is None:
                with self.cache.store(place, key) as folder:
                    fit_spread(train_on, self.config, variant, folder / f"{Path(place).name}.npz")
        return fitted


def each(jobs: Sequence[SplitJob], processes: int) -> Iterator[list[str]]:
    """Run splits side by side, in their order; they share nothing, so results do not depend on how many."""
    if min(processes, len(jobs)) <= 1:
        yield from map(SplitJob.run, jobs)
        return
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        yield from pool.map(SplitJob.run, jobs)


def exports(job: SplitJob) -> list[tuple[str, str]]:
    """Places and keys of the models of all jumps in the form that others read."""
    spreads = sorted(job.spread_keys.items())
    return [
        (f"{EXPORTED}/{name}", result_key(export.write, (name, key, spreads)))
        for name, key in job.keys.items()
        if not name.endswith(NOT_EXPORTED)
    ]


def export_models(job: SplitJob) -> None:
    """Write the models of all jumps for others, where they changed."""
    for place, key in exports(job):
        if job.cache.get(place, key) is None:
            name = Path(place).name
            model = load(job.cache.folder / job.split.name, name)
            with job.cache.store(place, key) as folder:
                export.write(model, folder, name, deviation_of(job.cache.folder, job.split, name))


def spread_variants(config: TrainConfig, split: Split) -> list[str]:
    """Kernels whose errors are learned too; a whole session held out is another distribution, which none foresees."""
    if split.name.startswith("session") or len(split.train) < 2:
        return []
    return [variant for variant in ("", NO_PHASE, FORECAST) if f"kernel{variant}" in config.models_of(split)]


def spread_name(split: Split, variant: str) -> str:
    """``<split>/spread<variant>``."""
    return f"{split.name}/spread{variant}"


def deviation_of(out: Path, split: Split, name: str) -> np.ndarray | None:
    """Expected errors of a learned model in familiar situations, (starts, K, 6), where they were learned."""
    family, _, variant = name.partition("_")
    path = out / f"{spread_name(split, f'_{variant}' if variant else '')}.npz"
    return np.sqrt(read_npz(path)["variance"]) if family in (*BLENDED, "blend") and path.is_file() else None


def keys_of(windows: Windows, split: Split, config: TrainConfig) -> dict[str, str]:
    """The keys of all models of a split."""
    return {name: key_of(windows, split, name, config) for name in config.models_of(split)}


def key_of(windows: Windows, split: Split, name: str, config: TrainConfig) -> str:
    """Hash of a model's windows, settings and code; its held-out windows only shape its curve."""
    jumps = windows.of_jumps(split.train + split.held_out)
    inputs = {
        "model": name,
        "settings": settings_of(name, config),
        "train": split.train,
        "held_out": split.held_out,
        "windows": {array: getattr(jumps, array) for array in ARRAYS},
        "purpose": Purpose.of(windows),
    }
    return result_key(FITS[name], inputs)


def settings_of(name: str, config: TrainConfig) -> dict[str, Any]:
    """The part of the settings that one model depends on."""
    settings = asdict(config)
    for place in ("windows", "out", "models", "not_in_sessions", "folds", "sessions", "processes"):
        settings.pop(place)
    for section in ("kernel", "networks", "published_recipe"):
        if not name.startswith(section) and not (name.startswith("blend") and section in BLENDED):
            settings.pop(section)
    settings["trainer"].pop("enable_progress_bar", None)
    return settings


def write_all_curves(out: Path, models: dict[str, list[str]]) -> None:
    """``curves.csv``: the losses along all trainings, by split and model."""
    with whole_file(out / CURVES) as beside, beside.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["split", "model", "step", "train_loss", "validation_loss"])
        for split, names in models.items():
            for name in names:
                rows = read_json(out / split / f"{name}.curve.json")["rows"]
                writer.writerows([split, name, *("" if v is None else f"{v:.6g}" for v in row)] for row in rows)

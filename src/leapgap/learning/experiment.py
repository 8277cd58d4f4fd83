"""All models on all splits: fitted where they are not there yet, kept where they are."""

import csv
import hashlib
import json
import shutil
from collections.abc import Callable, Iterator, Sequence, Set
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import leapgap
from leapgap.errors import InputError
from leapgap.files import read_json, whole_file, write_json
from leapgap.learning import export, uncertainty
from leapgap.learning.initialisation import NetworksConfig, PublishedRecipeConfig
from leapgap.learning.kernel import KernelConfig, KernelModel
from leapgap.learning.model import Model
from leapgap.learning.recipe import FitTask, ModelRecipe, TrainingRun
from leapgap.learning.registry import RECIPES
from leapgap.learning.splits import Split, folds, sessions, train_on_all
from leapgap.learning.store import StoredModel, load, save, stored_key
from leapgap.recording.windows import ARRAYS, Purpose, Windows, read_npz
from leapgap.robot.rigid_body import RigidBody

CODE = ("learning", "recording/windows.py", "robot/rigid_body.py", "robot/schedule.py")
"""What a trained model depends on, in this package."""
EXPORTED = "exported"
"""Folder of the models fitted on all jumps as others read them: ``control.exported``, ONNX."""


MODELS = (
    *("nominal_published", "nominal", "nominal_fitted", "constant_velocity", "playback", "published_recipe"),
    *("networks", "networks_no_phase", "kernel", "kernel_no_phase", "blend", "blend_no_phase"),
    *("networks_forecast", "kernel_forecast"),
)
"""Fitted unless others are asked for."""
NOT_IN_SESSIONS = ("published_recipe", "networks_forecast", "kernel_forecast")
"""Models that take long, or that are only compared with others of the same folds."""
TRAINER = {"accelerator": "cpu", "devices": 1, "enable_progress_bar": True}


@dataclass
class TrainConfig:
    """The section ``train`` of the configuration: data, splits, models and their settings."""

    windows: str
    sessions: list[list[str]] | None
    """Patterns of the names of the jumps of each session; None: no sessions are held out."""
    out: str | None = None
    models: list[str] = field(default_factory=lambda: list(MODELS))
    """Which of the models to fit, by name."""
    not_in_sessions: list[str] = field(default_factory=lambda: list(NOT_IN_SESSIONS))
    """Those left out where whole sessions are held out, to save time."""
    folds: int = 4
    """Fold f holds out jumps f, f + folds, …"""
    seed: int = 0
    mass_kg: float = 12.453
    pitch_inertia_kgm2: float = 0.347
    """Of the nominal body that residuals correct."""
    curvature: float = 0.5
    """Of the steps' positions in all models but the published ones, as in ``rigid_body.advance``."""
    kernel: KernelConfig = field(default_factory=KernelConfig)
    networks: NetworksConfig = field(default_factory=NetworksConfig)
    published_recipe: PublishedRecipeConfig = field(default_factory=PublishedRecipeConfig)
    steps_an_epoch: int = 25
    threads: int = 1
    """Of torch on the CPU; sums, hence the last bits of the weights, depend on it."""
    processes: int = 2
    """Splits fitted at the same time."""
    trainer: dict[str, Any] = field(default_factory=lambda: dict(TRAINER))
    """What Lightning's Trainer is told."""

    def models_of(self, split: Split) -> list[str]:
        """Names of the models that are fitted on a split."""
        skipped = self.not_in_sessions if split.name.startswith("session") else []
        judged = bool(split.held_out)  # forecasts are judged, never used
        return [name for name in self.models if name not in skipped and (judged or not RECIPES[name].is_forecast)]

    @property
    def body(self) -> RigidBody:
        """The nominal body that residuals correct."""
        return RigidBody(self.mass_kg, self.pitch_inertia_kgm2)


def fit_task(
    config: TrainConfig, split: Split, name: str, train: Windows, held_out: Windows, folder: Path, scratch: Path
) -> FitTask:
    """What a recipe is given for one model of one split; ``folder`` holds the models fitted on the split before."""

    def member(other: str) -> Model:
        if other not in config.models_of(split) or stored_key(folder, other) is None:
            raise InputError("train.models", f"{name} before {other}", f"{other} before it", "correct conf/train")
        return load(folder, other).model

    run = TrainingRun(
        config.seed, config.threads, config.trainer, scratch, f"{split.name} {name}", config.steps_an_epoch
    )
    sections = (config.kernel, config.networks, config.published_recipe)
    return FitTask(train, held_out, config.body, config.curvature, sections, run, member)


def train(
    windows: Windows, config: TrainConfig, out: Path, progress: Callable[[str], None] = lambda _: None
) -> list[str]:
    """Fit every model on every split into ``<out>/<split>/<model>``; the names of what had to be fitted.

    A model whose data, settings and code are unchanged is kept; files of models nobody asked for are removed.
    Beside them: ``splits.json``, and ``curves.csv`` of those that were trained in steps.
    """
    unknown = [name for name in config.models if name not in RECIPES]
    if unknown:
        raise InputError("train.models", ", ".join(unknown), f"some of {', '.join(RECIPES)}", "correct conf/train")
    out.mkdir(parents=True, exist_ok=True)
    if not len(windows):
        forget(out, set())
        write_json(out / "note.json", {"note": "no logs: nothing was trained"})
        return []
    splits = [
        *folds(windows.jumps, config.folds),
        *sessions(windows.jumps, config.sessions or []),
        train_on_all(windows.jumps),
    ]
    used = [name for name in config.models_of(splits[-1]) if RECIPES[name].can_be_exported]
    keys = {
        (split.name, name): key_of(windows, split, name, config) for split in splits for name in config.models_of(split)
    }
    wanted = {f"{split}/{name}" for split, name in keys} | {f"{EXPORTED}/{name}" for name in used}
    wanted |= {
        f"{split.name}/{recipe.uncertainty_file}" for split in splits for recipe in uncertainty_recipes(config, split)
    }
    forget(out, wanted, {f"{name}-{key[:12]}" for (_, name), key in keys.items()})
    jobs = [
        SplitJob(windows, config, split, {n: keys[split.name, n] for n in config.models_of(split)}, out)
        for split in splits
    ]
    fitted: list[str] = []
    for number, done in enumerate(each(jobs, config.processes)):
        fitted += done
        progress(f"{splits[number].name} ({number + 1} of {len(splits)}): {len(done)} models fitted")
    write_json(
        out / "splits.json",
        {
            split.name: {"models": config.models_of(split), "train": split.train, "held_out": split.held_out}
            for split in splits
        },
    )
    for name in used:
        if stored_key(out / EXPORTED, name) != keys[splits[-1].name, name]:
            export.write(load(out / splits[-1].name, name), out / EXPORTED, name, deviation_of(out, splits[-1], name))
    write_all_curves(out, {split.name: config.models_of(split) for split in splits})
    return fitted


@dataclass(frozen=True)
class SplitJob:
    """All models of one split."""

    windows: Windows
    config: TrainConfig
    split: Split
    keys: dict[str, str]
    """Keys of the models to have, by name."""
    out: Path

    def run(self) -> list[str]:
        """Fit what is not there; the names of what was fitted."""
        folder, fitted = self.out / self.split.name, []
        train_on, held_out = (self.windows.of_jumps(jumps) for jumps in (self.split.train, self.split.held_out))
        for name, key in self.keys.items():
            if stored_key(folder, name) != key:
                scratch = folder / f".{name}-{key[:12]}"
                task = fit_task(self.config, self.split, name, train_on, held_out, folder, scratch)
                model, curve = RECIPES[name].fit(task)
                write_json(folder / f"{name}.curve.json", {"rows": curve})
                save(StoredModel(model, Purpose.of(self.windows), self.split.train, key), folder, name)
                fitted.append(f"{self.split.name}/{name}")
        for recipe in uncertainty_recipes(self.config, self.split):
            path = folder / f"{recipe.uncertainty_file}.npz"
            if not path.is_file() or f"{self.split.name}/{recipe.name}" in fitted:
                fit_uncertainty(train_on, self.config, recipe, path)
        return fitted


def each(jobs: Sequence[SplitJob], processes: int) -> Iterator[list[str]]:
    """Run splits side by side, in their order; they share nothing, so results do not depend on how many."""
    if min(processes, len(jobs)) <= 1:
        yield from map(SplitJob.run, jobs)
        return
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        yield from pool.map(SplitJob.run, jobs)


def uncertainty_recipes(config: TrainConfig, split: Split) -> list[ModelRecipe]:
    """Recipes whose errors on left-out training jumps are learned on a split.

    A whole session held out is another distribution, which no training jump foresees.
    """
    if split.name.startswith("session") or len(split.train) < 2:
        return []
    names = config.models_of(split)
    return [recipe for recipe in RECIPES.values() if recipe.uncertainty_file and recipe.name in names]


def deviation_of(out: Path, split: Split, name: str) -> np.ndarray | None:
    """Expected errors of a model in familiar situations, (starts, K, 6), where they were learned."""
    source = RECIPES.get(RECIPES[name].uncertainty_from or "")
    path = out / split.name / f"{source.uncertainty_file}.npz" if source else None
    return np.sqrt(read_npz(path)["variance"]) if path and path.is_file() else None


def fit_uncertainty(windows: Windows, config: TrainConfig, recipe: ModelRecipe, path: Path) -> None:
    """Learn the errors of a kernel by leaving out each training jump in turn, and write them."""

    def fit_kernel(train: Windows) -> KernelModel:
        split = Split("", train.jumps, ())
        task = fit_task(config, split, recipe.name, train, train.of_jumps([]), path.parent, path.parent)
        model, _ = recipe.fit(task)
        assert isinstance(model, KernelModel)
        return model

    uncertainty.save(uncertainty.fit(windows, fit_kernel, config.kernel), path)


def key_of(windows: Windows, split: Split, name: str, config: TrainConfig) -> str:
    """Hash of a model's training windows, settings and code; its held-out windows only shape its curve."""
    settings = asdict(config)
    for place in ("windows", "out", "models", "not_in_sessions", "folds", "sessions", "processes"):
        settings.pop(place)
    for section in ("kernel", "networks", "published_recipe"):
        if not isinstance(getattr(config, section), RECIPES[name].settings):
            settings.pop(section)
    settings["trainer"].pop("enable_progress_bar", None)
    digest = hashlib.sha256(json.dumps([name, settings, split.train, split.held_out], sort_keys=True).encode())
    for array in ARRAYS:
        digest.update(np.ascontiguousarray(getattr(windows.of_jumps(split.train + split.held_out), array)).tobytes())
    digest.update(repr(Purpose.of(windows)).encode())
    digest.update(code_version().encode())
    return digest.hexdigest()


def code_version() -> str:
    """Hash of the source files that make a model what it is."""
    root = Path(leapgap.__file__).parent
    files = [file for place in CODE for file in (sorted((root / place).glob("*.py")) or [root / place])]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def forget(out: Path, wanted: Set[str], scratches: Set[str] = frozenset()) -> None:
    """Remove what is neither a wanted ``<split>/<model>`` nor its unfinished training."""
    for path in out.iterdir():
        if path.is_dir():
            for item in path.iterdir():
                if item.is_dir() and item.name.removeprefix(".") not in scratches:
                    shutil.rmtree(item)
                elif item.is_file() and f"{path.name}/{item.name.split('.')[0]}" not in wanted:
                    item.unlink()
            if not any(path.iterdir()):
                path.rmdir()
        else:
            path.unlink()


def write_all_curves(out: Path, models: dict[str, list[str]]) -> None:
    """``curves.csv``: the losses along all trainings, by split and model."""
    with whole_file(out / "curves.csv") as beside, beside.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["split", "model", "step", "train_loss", "validation_loss"])
        for split, names in models.items():
            for name in names:
                rows = read_json(out / split / f"{name}.curve.json")["rows"]
                writer.writerows([split, name, *("" if v is None else f"{v:.6g}" for v in row)] for row in rows)

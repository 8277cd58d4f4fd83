"""All models on all splits: fitted where they are not in the cache, kept where they are."""

import csv
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.learning import loggers
from leapgap.jumping.learning.experiment import (
    Split,
    TrainConfig,
    fit_task,
    fit_uncertainty,
    folds,
    sessions,
    train_on_all,
)
from leapgap.jumping.learning.model import Model
from leapgap.jumping.learning.model_files import read_npz
from leapgap.jumping.learning.recipe import FitTask, LearningCurve, ModelRecipe, ModelSettings
from leapgap.jumping.learning.store import StoredModel, export_model, find_recipe, load, recipes, save
from leapgap.jumping.learning.windows import ARRAYS, Purpose, Windows
from leapgap.runtime.atomic_io import read_json, whole_file, write_json
from leapgap.runtime.blas import one_blas_thread
from leapgap.runtime.cache import ResultCache, result_key
from leapgap.runtime.processes import starting_workers

EXPORTED = "exported"
"""Folder of the models fitted on all jumps as others read them: ``jumping.control.inference``, ONNX."""
CURVES, SPLITS, NOTE = "curves.csv", "splits.json", "note.json"


def train(
    windows: Windows, config: TrainConfig, out: Path, progress: Callable[[str], None] = lambda _: None
) -> list[str]:
    """Fit every model on every split into ``<out>/<split>/<model>``; the names of what had to be fitted.

    A model whose data, settings and code are unchanged is kept; models nobody asked for are removed. Beside them:
    ``splits.json``, and ``curves.csv`` of those that were trained in steps.
    """
    unknown = [name for name in config.models if name not in recipes()]
    if unknown:
        raise InputError("train.models", ", ".join(unknown), f"some of {', '.join(recipes())}", "correct conf/train")
    out.mkdir(parents=True, exist_ok=True)
    cache = ResultCache(out)
    if not len(windows):
        cache.sweep()
        for name in (CURVES, SPLITS):
            (out / name).unlink(missing_ok=True)
        write_json(out / NOTE, {"note": "no logs: nothing was trained"})
        return []
    (out / NOTE).unlink(missing_ok=True)
    loggers.prepare(config.logger, out)
    splits = [
        *folds(windows.jumps, config.folds),
        *sessions(windows.jumps, config.sessions or []),
        train_on_all(windows.jumps),
    ]
    jobs = [SplitJob(windows, config, split, keys_of(windows, split, config), cache) for split in splits]
    for place, key in [pair for job in jobs for pair in job.places()] + exports(jobs[-1]):
        cache.expect(place, key)
    cache.sweep()
    parts = [part for job in jobs for part in job.parts() if not part.is_kept]
    left, ready = Counter(part.job.split.name for part in parts), 0
    for done in run_parts(parts, config.processes):
        name = done.job.split.name
        left[name] -= 1
        if not left[name]:
            ready += 1
            models = sum(part.is_model and part.job.split.name == name for part in parts)
            progress(f"{name} ({ready} of {len(splits)}): {models} models fitted")
    write_json(
        out / SPLITS,
        {
            split.name: {"models": config.models_of(split), "train": split.train, "held_out": split.held_out}
            for split in splits
        },
    )
    export_models(jobs[-1])
    write_all_curves(out, {split.name: config.models_of(split) for split in splits})
    return [part.place for part in parts if part.is_model]


@dataclass(frozen=True)
class SplitJob:
    """What is fitted on one split."""

    windows: Windows
    config: TrainConfig
    split: Split
    keys: dict[str, str]  # Cache key of each model that is fitted on this split, by the model's name
    cache: ResultCache

    @property
    def uncertainty_keys(self) -> dict[str, str]:
        """Keys of the learned errors, by the model whose errors they are."""
        return {
            recipe.name: result_key(fit_uncertainty, self.keys[recipe.name])
            for recipe in uncertainty_recipes(self.config, self.split)
        }

    def places(self) -> list[tuple[str, str]]:
        """Places and keys of all results."""
        models = [(f"{self.split.name}/{name}", key) for name, key in self.keys.items()]
        return models + [(uncertainty_place(self.split, name), key) for name, key in self.uncertainty_keys.items()]

    def parts(self) -> list["Part"]:
        """Everything to fit, models in their order and then the learned errors."""
        models = [Part(self, name, f"{self.split.name}/{name}", key, True) for name, key in self.keys.items()]
        errors = self.uncertainty_keys.items()
        return models + [Part(self, name, uncertainty_place(self.split, name), key, False) for name, key in errors]


@dataclass(frozen=True)
class Part:
    """Fits one model of a split, or learns the errors of one."""

    job: SplitJob
    name: str  # Name of the model that is fitted, or whose errors are learned
    place: str
    key: str
    is_model: bool

    @property
    def is_kept(self) -> bool:
        """Whether the result is in the cache."""
        return self.job.cache.get(self.place, self.key) is not None

    @property
    def needs(self) -> set[str]:
        """Places of the models of the same split that have to be fitted before."""
        members = find_recipe(self.name, "train.models").members if self.is_model else ()
        return {f"{self.job.split.name}/{member}" for member in members}

    @one_blas_thread()
    def run(self) -> None:
        """Fit it, and put it into the cache."""
        job, split, cache, recipe = self.job, self.job.split, self.job.cache, recipes()[self.name]
        train_on, held_out = (job.windows.of_jumps(jumps) for jumps in (split.train, split.held_out))
        with cache.store(self.place, self.key) as folder:
            if self.is_model:
                of_split, scratch = cache.folder / split.name, cache.scratch(self.place, self.key)
                task = fit_task(job.config, split, self.name, train_on, held_out, of_split, scratch)
                model, curve = fit(recipe, task)
                write_json(folder / f"{self.name}.curve.json", {"rows": curve})
                save(StoredModel(model, Purpose.of(job.windows), split.train, self.key), folder, self.name)
            else:
                fit_uncertainty(train_on, job.config, recipe, folder / f"{Path(self.place).name}.npz")


def fit(recipe: ModelRecipe, task: FitTask) -> tuple[Model, LearningCurve]:
    """Fit a recipe's model; ``InputError`` where its equations have no solution."""
    try:
        return recipe.fit(task)
    except np.linalg.LinAlgError as error:
        do = "raise its ridge in conf/train, or look for jumps that are copies of one another"
        raise InputError(f"model {recipe.name}", f"no solution ({error})", "equations that determine it", do) from None


def run_parts(parts: Sequence[Part], processes: int) -> Iterator[Part]:
    """Run parts side by side and yield each when it is done; one starts when those that it needs are there.

    What is needed but not among the parts is in the cache, or its absence is an error of the part. Results do not
    depend on the number of processes.
    """
    if min(processes, len(parts)) <= 1:
        for part in parts:
            part.run()
            yield part
        return
    waiting, missing = list(parts), {part.place for part in parts}
    running: dict[Future[None], Part] = {}
    with starting_workers() as (initializer, arguments):
        pool = ProcessPoolExecutor(
            processes, mp_context=get_context("spawn"), initializer=initializer, initargs=arguments
        )
        running |= start_ready(pool, waiting, missing)
    try:
        while running:
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                part = running.pop(future)
                future.result()
                missing.discard(part.place)
                yield part
            running |= start_ready(pool, waiting, missing)
    finally:
        pool.shutdown(cancel_futures=True)


def start_ready(pool: ProcessPoolExecutor, waiting: list[Part], missing: set[str]) -> "dict[Future[None], Part]":
    """Start the parts, of those that wait, that need nothing that is missing; they wait no longer."""
    ready = [part for part in waiting if not part.needs & missing]
    waiting[:] = [part for part in waiting if part.needs & missing]
    return {pool.submit(part.run): part for part in ready}


def exports(job: SplitJob) -> list[tuple[str, str]]:
    """Places and keys of the models of all jumps in the form that others read."""
    uncertainties = sorted(job.uncertainty_keys.items())
    return [
        (f"{EXPORTED}/{name}", result_key(export_model, (name, key, uncertainties)))
        for name, key in job.keys.items()
        if recipes()[name].can_be_exported
    ]


def export_models(job: SplitJob) -> None:
    """Write the models of all jumps for others, where they changed."""
    for place, key in exports(job):
        if job.cache.get(place, key) is None:
            name = Path(place).name
            model = load(job.cache.folder / job.split.name, name)
            with job.cache.store(place, key) as folder:
                export_model(model, folder, name, deviation_of(job.cache.folder, job.split, name))


def uncertainty_recipes(config: TrainConfig, split: Split) -> list[ModelRecipe]:
    """Recipes whose errors on left-out training jumps are learned on a split.

    A whole session held out is another distribution, which no training jump foresees.
    """
    if split.name.startswith("session") or len(split.train) < 2:
        return []
    names = config.models_of(split)
    return [recipe for recipe in recipes().values() if recipe.uncertainty_file and recipe.name in names]


def uncertainty_place(split: Split, name: str) -> str:
    """Where the learned errors of a model are kept: ``<split>/spread``."""
    return f"{split.name}/{recipes()[name].uncertainty_file}"


def deviation_of(out: Path, split: Split, name: str) -> np.ndarray | None:
    """Expected errors of a model in familiar situations, (starts, K, 6), where they were learned."""
    source = recipes()[name].uncertainty_from
    path = out / f"{uncertainty_place(split, source)}.npz" if source in recipes() else None
    return np.sqrt(read_npz(path)["variance"]) if path and path.is_file() else None


def keys_of(windows: Windows, split: Split, config: TrainConfig) -> dict[str, str]:
    """The keys of all models of a split."""
    return {name: key_of(windows, split, name, config) for name in config.models_of(split)}


def key_of(windows: Windows, split: Split, name: str, config: TrainConfig) -> str:
    """Hash of a model's windows, settings and code; its held-out windows only shape its curve."""
    jumps = windows.of_jumps(split.train + split.held_out)
    inputs = {
        "models": with_members(name),
        "settings": shared_settings(config) | {"model_settings": own_settings(name, config)},
        "train": split.train,
        "held_out": split.held_out,
        "windows": {array: getattr(jumps, array) for array in ARRAYS},
        "purpose": Purpose.of(windows),
    }
    return result_key(fit_task, inputs)


def with_members(name: str) -> list[ModelRecipe]:
    """The recipe of a model, and those of the models that its fit reads."""
    recipe = find_recipe(name, "train.models")
    return [recipe, *(one for member in recipe.members for one in with_members(member))]


def own_settings(name: str, config: TrainConfig) -> dict[str, ModelSettings]:
    """The settings of their own that a model and its members depend on, by section."""
    kinds = [recipe.settings for recipe in with_members(name) if recipe.settings]
    return {kind.section: config.settings(kind) for kind in kinds}


def shared_settings(config: TrainConfig) -> dict[str, Any]:
    """The settings that every model depends on."""
    settings = asdict(config)
    others = (
        "windows",
        "out",
        "models",
        "not_in_sessions",
        "folds",
        "sessions",
        "processes",
        "logger",
        "model_settings",
    )
    for name in others:
        settings.pop(name)
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

"""All models on all splits: fitted where they are not in the cache, kept where they are."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import asdict, dataclass
from functools import cached_property
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.learning.experiment import Split, TrainConfig, fit_task, fit_uncertainty, folds, sessions
from leapgap.jumping.learning.loggers import make_logger
from leapgap.jumping.learning.model_files import read_npz, write_csv
from leapgap.jumping.learning.recipe import ModelRecipe, ModelSettings
from leapgap.jumping.learning.store import StoredModel, export_model, find_recipe, load, recipes, save
from leapgap.jumping.learning.windows import ARRAYS, Purpose, Windows
from leapgap.runtime.atomic_io import read_json, write_json
from leapgap.runtime.blas import one_blas_thread
from leapgap.runtime.cache import ResultCache, result_key
from leapgap.runtime.processes import starting_workers

EXPORTED = "exported"  # Folder of the models of all jumps as others read them: ``jumping.control.inference``, ONNX
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
    # Looks for the logger's package before any work, and makes what trainings side by side would make twice.
    make_logger(config.logger, out, "no run is begun by this")
    jumps = windows.jumps
    splits = [*folds(jumps, config.folds), *sessions(jumps, config.sessions or []), Split("all", tuple(jumps), ())]
    jobs = [SplitJob(windows, config, split, cache) for split in splits]
    every, used = [part for job in jobs for part in job.parts], jobs[-1]
    for place, key in [(part.place, part.key) for part in every] + used.exports:
        cache.expect(place, key)
    cache.sweep()
    parts = [part for part in every if cache.get(part.place, part.key) is None]
    left, ready = Counter(part.job.split.name for part in parts), 0
    for done in run_parts(parts, config.processes):
        name = done.job.split.name
        left[name] -= 1
        if not left[name]:
            ready += 1
            models = sum(part.is_model and part.job.split.name == name for part in parts)
            progress(f"{name} ({ready} of {len(splits)}): {models} models fitted")
    models_of = {split.name: config.models_of(split) for split in splits}
    about = {one.name: {"models": models_of[one.name], "train": one.train, "held_out": one.held_out} for one in splits}
    write_json(out / SPLITS, about)
    for place, key in used.exports:
        if cache.get(place, key) is None:
            name = Path(place).name
            source = recipes()[name].uncertainty_from
            path = out / f"{uncertainty_place(used.split, source)}.npz" if source in recipes() else None
            variance = read_npz(path)["variance"] if path and path.is_file() else None
            with cache.store(place, key) as folder:
                model, deviation = load(out / used.split.name, name), None if variance is None else np.sqrt(variance)
                export_model(model, folder, name, deviation)
    curves = [
        (of, name, *("" if value is None else f"{value:.6g}" for value in row))
        for of, names in models_of.items()
        for name in names
        for row in read_json(out / of / f"{name}.curve.json")["rows"]
    ]
    write_csv(out / CURVES, ["split", "model", "step", "train_loss", "validation_loss"], curves)
    return [part.place for part in parts if part.is_model]


@dataclass(frozen=True)
class SplitJob:
    """What is fitted on one split."""

    windows: Windows
    config: TrainConfig
    split: Split
    cache: ResultCache

    @cached_property
    def keys(self) -> dict[str, str]:
        """Cache key of each model that is fitted on this split, by the model's name."""
        return {name: key_of(self.windows, self.split, name, self.config) for name in self.config.models_of(self.split)}

    @cached_property
    def uncertainty_keys(self) -> dict[str, str]:
        """Keys of the learned errors on left-out training jumps, by the model whose errors they are.

        A whole session held out is another distribution, which no training jump foresees.
        """
        if self.split.name.startswith("session") or len(self.split.train) < 2:
            return {}
        named = [name for name, recipe in recipes().items() if recipe.uncertainty_file and name in self.keys]
        return {name: result_key(fit_uncertainty, self.keys[name]) for name in named}

    @property
    def parts(self) -> list["Part"]:
        """Everything to fit, models in their order and then the learned errors."""
        models = [Part(self, name, f"{self.split.name}/{name}", key, True) for name, key in self.keys.items()]
        errors = self.uncertainty_keys.items()
        return models + [Part(self, name, uncertainty_place(self.split, name), key, False) for name, key in errors]

    @property
    def exports(self) -> list[tuple[str, str]]:
        """Places and keys of the models of this split in the form that others read."""
        errors = sorted(self.uncertainty_keys.items())
        exported = [(name, key) for name, key in self.keys.items() if recipes()[name].can_be_exported]
        return [(f"{EXPORTED}/{name}", result_key(export_model, (name, key, errors))) for name, key in exported]


@dataclass(frozen=True)
class Part:
    """Fits one model of a split, or learns the errors of one."""

    job: SplitJob
    name: str  # Name of the model that is fitted, or whose errors are learned
    place: str
    key: str
    is_model: bool

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
                try:
                    model, curve = recipe.fit(task)
                except np.linalg.LinAlgError as error:
                    found = f"no solution ({error})"
                    do = "raise its ridge in conf/train, or look for jumps that are copies of one another"
                    raise InputError(f"model {self.name}", found, "equations that determine it", do) from None
                write_json(folder / f"{self.name}.curve.json", {"rows": curve})
                save(StoredModel(model, Purpose.of(job.windows), split.train, self.key), folder, self.name)
            else:
                fit_uncertainty(train_on, job.config, recipe, folder / f"{Path(self.place).name}.npz")


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

    def start_ready() -> None:
        for part in [one for one in waiting if not one.needs & missing]:
            waiting.remove(part)
            running[pool.submit(part.run)] = part

    with starting_workers() as (initializer, arguments):
        pool = ProcessPoolExecutor(
            processes, mp_context=get_context("spawn"), initializer=initializer, initargs=arguments
        )
        start_ready()
    try:
        while running:
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                part = running.pop(future)
                future.result()
                missing.discard(part.place)
                yield part
            start_ready()
    finally:
        pool.shutdown(cancel_futures=True)


def uncertainty_place(split: Split, name: str) -> str:
    """Where the learned errors of a model are kept: ``<split>/spread``."""
    return f"{split.name}/{recipes()[name].uncertainty_file}"


def key_of(windows: Windows, split: Split, name: str, config: TrainConfig) -> str:
    """Hash of a model's windows, settings and code; its held-out windows only shape its curve."""
    jumps, settings = windows.of_jumps(split.train + split.held_out), asdict(config)
    for shapes_no_model in ("windows", "out", "models", "not_in_sessions", "folds", "sessions", "processes", "logger"):
        settings.pop(shapes_no_model)
    settings["trainer"].pop("enable_progress_bar", None)
    inputs = {
        "models": with_members(name),
        "settings": settings | {"model_settings": own_settings(name, config)},
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

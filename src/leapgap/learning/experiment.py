"""All models on all splits: fitted where they are not there yet, kept where they are."""

import csv
import hashlib
import json
import shutil
from collections.abc import Callable, Iterator, Sequence, Set
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import leapgap
from leapgap.errors import InputError
from leapgap.files import read_json, whole_file, write_json
from leapgap.learning import export, kernel, spread, untrained
from leapgap.learning.baselines import ConstantVelocity, NominalModel, Playback, fit_gains
from leapgap.learning.blend import Blend
from leapgap.learning.kernel import KernelConfig, KernelModel
from leapgap.learning.model import Model, Nominal, ResidualModel
from leapgap.learning.network import NetworkForecast, NetworkModel
from leapgap.learning.splits import Split, everything, folds, sessions
from leapgap.learning.store import Stored, load, save, stored_key
from leapgap.learning.untrained import Fitting, NetworksConfig, PublishedRecipeConfig
from leapgap.recording.windows import ARRAYS, Purpose, Windows, read_npz
from leapgap.robot.rigid_body import PUBLISHED, RigidBody

CODE = ("learning", "recording/windows.py", "robot/rigid_body.py", "robot/schedule.py")
"""What a trained model depends on, in this package."""
FORECAST = "_forecast"
NO_PHASE = "_no_phase"
EXPORTED = "exported"
"""Folder of the models fitted on all jumps as others read them: ``control.exported``, ONNX."""
NOT_EXPORTED = (FORECAST, "constant_velocity", "playback")
"""No models of how forces move the base."""


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
    """Section train."""

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
        """What is fitted on a split."""
        skipped = self.not_in_sessions if split.name.startswith("session") else []
        judged = bool(split.held_out)  # forecasts are judged, never used
        return [name for name in self.models if name not in skipped and (judged or not name.endswith(FORECAST))]

    @property
    def body(self) -> RigidBody:
        """The nominal body."""
        return RigidBody(self.mass_kg, self.pitch_inertia_kgm2)


@dataclass(frozen=True)
class Task:
    """One model of one split."""

    config: TrainConfig
    split: Split
    name: str
    train: Windows
    held_out: Windows
    folder: Path
    """Of the split's models; those fitted before are there."""
    scratch: Path

    @property
    def inputs(self) -> dict[str, dict[str, float]]:
        """Inputs of the learned models, without the phase where the model's name says so."""
        given = {"kernel": self.config.kernel.inputs, "networks": self.config.networks.inputs}
        without = self.name.endswith(NO_PHASE)
        return {
            kind: {name: weight for name, weight in inputs.items() if not (without and name == "phase")}
            for kind, inputs in given.items()
        }


BLENDED = ("networks", "kernel")
Curve = list[list[float | None]]


def fit_kernel(task: Task) -> tuple[Model, Curve]:
    """Residual of the body with fitted gains."""
    config = KernelConfig(**{**vars(task.config.kernel), "inputs": task.inputs["kernel"]})
    return kernel.fit(task.train, fit_gains(task.train, task.config.body, task.config.curvature), config), []


def fit_forecast(task: Task) -> tuple[Model, Curve]:
    """What acts later is not known: no feet and forces among the inputs."""
    return kernel.fit_forecast(task.train, task.config.kernel, task.config.curvature), []


def fit_networks(task: Task) -> tuple[Model, Curve]:
    """Ours: residual of the body with fitted gains."""
    config = NetworksConfig(**{**vars(task.config.networks), "inputs": task.inputs["networks"]})
    nominal = fit_gains(task.train, task.config.body, task.config.curvature)
    start = untrained.networks(task.train, nominal, config, np.random.default_rng(task.config.seed))
    return descend(start, task, config.fitting)


def fit_networks_forecast(task: Task) -> tuple[Model, Curve]:
    """What acts later is not known: whole accelerations of state and phase, no nominal body under them."""
    inputs = {name: weight for name, weight in task.config.networks.inputs.items() if "foot" not in name}
    config = NetworksConfig(**{**vars(task.config.networks), "inputs": inputs})
    blind = replace(task, train=without_forces(task.train), held_out=without_forces(task.held_out))
    nothing = Nominal(RigidBody(mass_kg=np.inf, pitch_inertia_kgm2=np.inf), curvature=task.config.curvature)
    start = untrained.networks(blind.train, nothing, config, np.random.default_rng(task.config.seed))
    model, curve = descend(start, blind, config.fitting)
    return NetworkForecast(**vars(model)), curve


def without_forces(windows: Windows) -> Windows:
    """The same motion, as if nothing pushed."""
    return replace(windows, force=np.zeros_like(windows.force), foot=np.zeros_like(windows.foot))


def fit_blend(task: Task) -> tuple[Model, Curve]:
    """Mean of networks and kernel of the same split, with or without phase."""
    members = []
    for kind in BLENDED:
        name = task.name.replace("blend", kind)
        if name not in task.config.models_of(task.split) or stored_key(task.folder, name) is None:
            raise InputError("train.models", f"{task.name} before {name}", f"{name} before it", "correct conf/train")
        model = load(task.folder, name).model
        assert isinstance(model, ResidualModel)
        members.append(model)
    return Blend(tuple(members)), []


def fit_published(task: Task) -> tuple[Model, Curve]:
    """The paper's."""
    config = task.config.published_recipe
    nominal = Nominal(RigidBody(config.mass_kg, config.pitch_inertia_kgm2))
    start = untrained.published(task.train.grid, nominal, config, np.random.default_rng(task.config.seed))
    return descend(start, task, config.fitting)


def descend(start: NetworkModel, task: Task, fitting: Fitting) -> tuple[NetworkModel, Curve]:
    """Train; torch and Lightning take seconds to import, so only here."""
    from leapgap.learning import training

    held_out = task.held_out if len(task.held_out) else None
    run = training.Run(
        task.config.seed,
        task.config.threads,
        task.config.trainer,
        task.scratch,
        f"{task.split.name} {task.name}",
        task.config.steps_an_epoch,
    )
    return training.fit(start, task.train, held_out, fitting, run)


FITS: dict[str, Callable[[Task], tuple[Model, Curve]]] = {
    "nominal": lambda task: (NominalModel(Nominal(task.config.body)), []),
    "nominal_published": lambda task: (NominalModel(Nominal(PUBLISHED)), []),
    "nominal_fitted": lambda task: (NominalModel(fit_gains(task.train, task.config.body, task.config.curvature)), []),
    "constant_velocity": lambda task: (ConstantVelocity(), []),
    "playback": lambda task: (Playback.fit(task.train), []),
    "kernel": fit_kernel,
    "kernel" + NO_PHASE: fit_kernel,
    "kernel" + FORECAST: fit_forecast,
    "networks": fit_networks,
    "networks" + NO_PHASE: fit_networks,
    "networks" + FORECAST: fit_networks_forecast,
    "blend": fit_blend,
    "blend" + NO_PHASE: fit_blend,
    "published_recipe": fit_published,
}
"""Every model, by the name its figures go under."""


def train(
    windows: Windows, config: TrainConfig, out: Path, progress: Callable[[str], None] = lambda _: None
) -> list[str]:
    """Fit every model on every split into ``<out>/<split>/<model>``; the names of what had to be fitted.

    A model whose data, settings and code are unchanged is kept; files of models nobody asked for are removed.
    Beside them: ``splits.json``, and ``curves.csv`` of those that were trained in steps.
    """
    unknown = [name for name in config.models if name not in FITS]
    if unknown:
        raise InputError("train.models", ", ".join(unknown), f"some of {', '.join(FITS)}", "correct conf/train")
    out.mkdir(parents=True, exist_ok=True)
    if not len(windows):
        forget(out, set())
        write_json(out / "note.json", {"note": "no logs: nothing was trained"})
        return []
    splits = [
        *folds(windows.jumps, config.folds),
        *sessions(windows.jumps, config.sessions or []),
        everything(windows.jumps),
    ]
    used = [name for name in config.models_of(splits[-1]) if not name.endswith(NOT_EXPORTED)]
    keys = {
        (split.name, name): key_of(windows, split, name, config) for split in splits for name in config.models_of(split)
    }
    wanted = {f"{split}/{name}" for split, name in keys} | {f"{EXPORTED}/{name}" for name in used}
    wanted |= {spread_name(split, variant) for split in splits for variant in spread_variants(config, split)}
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
    """By model."""
    out: Path

    def run(self) -> list[str]:
        """Fit what is not there; the names of what was fitted."""
        folder, fitted = self.out / self.split.name, []
        train_on, held_out = (self.windows.of_jumps(jumps) for jumps in (self.split.train, self.split.held_out))
        for name, key in self.keys.items():
            if stored_key(folder, name) != key:
                scratch = folder / f".{name}-{key[:12]}"
                model, curve = FITS[name](Task(self.config, self.split, name, train_on, held_out, folder, scratch))
                write_json(folder / f"{name}.curve.json", {"rows": curve})
                save(Stored(model, Purpose.of(self.windows), self.split.train, key), folder, name)
                fitted.append(f"{self.split.name}/{name}")
        for variant in spread_variants(self.config, self.split):
            path = self.out / f"{spread_name(self.split, variant)}.npz"
            if not path.is_file() or f"{self.split.name}/kernel{variant}" in fitted:
                fit_spread(train_on, self.config, variant, path)
        return fitted


def each(jobs: Sequence[SplitJob], processes: int) -> Iterator[list[str]]:
    """Run splits side by side, in their order; they share nothing, so results do not depend on how many."""
    if min(processes, len(jobs)) <= 1:
        yield from map(SplitJob.run, jobs)
        return
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        yield from pool.map(SplitJob.run, jobs)


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


def fit_spread(windows: Windows, config: TrainConfig, variant: str, path: Path) -> None:
    """By leaving out each training jump in turn."""
    fit = FITS[f"kernel{variant}"]

    def fit_kernel(train: Windows) -> KernelModel:
        split = Split("", train.jumps, ())
        model, _ = fit(Task(config, split, f"kernel{variant}", train, train.of_jumps([]), path.parent, path.parent))
        assert isinstance(model, KernelModel)
        return model

    spread.save(spread.fit(windows, fit_kernel, config.kernel), path)


def key_of(windows: Windows, split: Split, name: str, config: TrainConfig) -> str:
    """Hash of a model's training windows, settings and code; its held-out windows only shape its curve."""
    settings = asdict(config)
    for place in ("windows", "out", "models", "not_in_sessions", "folds", "sessions", "processes"):
        settings.pop(place)
    for section in ("kernel", "networks", "published_recipe"):
        if not name.startswith(section) and not (name.startswith("blend") and section in BLENDED):
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

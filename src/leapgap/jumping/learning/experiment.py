"""How each model is fitted to the jumps of a split."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from leapgap.errors import InputError
from leapgap.jumping.learning import uncertainty
from leapgap.jumping.learning.loggers import LoggerConfig
from leapgap.jumping.learning.model import Model
from leapgap.jumping.learning.models.kernel import KernelConfig, KernelModel
from leapgap.jumping.learning.recipe import FitTask, ModelRecipe, ModelSettings, TrainingRun, WithModelSettings
from leapgap.jumping.learning.store import load, recipes
from leapgap.jumping.learning.windows import Windows
from leapgap.jumping.models.rigid_body import RigidBody


@dataclass(frozen=True)
class Split:
    """Jumps to train on and jumps to judge by."""

    name: str
    train: tuple[str, ...]
    held_out: tuple[str, ...]


def folds(jumps: Sequence[str], number: int) -> list[Split]:
    """Fold f holds out every ``number``-th jump from the f-th on, in the order given; fewer with fewer jumps."""
    number = min(number, len(jumps))
    return [hold_out(f"fold_{f}", jumps, jumps[f::number]) for f in range(number)] if number > 1 else []


def sessions(jumps: Sequence[str], groups: Sequence[Sequence[str]]) -> list[Split]:
    """One split a group of name patterns, which holds the whole group out.

    None where fewer than two groups have jumps, or where the session of some jump is not known; a jump in two
    groups is an ``InputError``.
    """
    members = [[jump for jump in jumps if any(fnmatchcase(jump, pattern) for pattern in group)] for group in groups]
    twice = [jump for jump in jumps if sum(jump in group for group in members) > 1]
    if twice:
        do = "correct the patterns, or set train.sessions=null"
        raise InputError("train.sessions", f"{', '.join(twice)} in several sessions", "each jump in one session", do)
    if sum(bool(group) for group in members) < 2 or sum(map(len, members)) < len(jumps):
        return []
    return [hold_out(f"session_{i}", jumps, group) for i, group in enumerate(members) if group]


def hold_out(name: str, jumps: Sequence[str], held_out: Sequence[str]) -> Split:
    """The split that holds some jumps out and trains on the others."""
    return Split(name, tuple(jump for jump in jumps if jump not in held_out), tuple(held_out))


MODELS = ("nominal", "nominal_fitted", "constant_velocity", "playback", "networks", "kernel", "blend")
"""Fitted unless others are asked for."""
NOT_IN_SESSIONS = ("published_recipe", "networks_forecast", "kernel_forecast")
"""Models that take long, or that are only compared with others of the same folds."""
TRAINER = {"accelerator": "cpu", "devices": 1, "enable_progress_bar": True}


@dataclass
class TrainConfig(WithModelSettings):
    """The section ``train`` of the configuration: data, splits and models.

    Settings of a model are a dataclass beside it, and a section ``train.<section>`` of their own.
    """

    windows: str
    sessions: list[list[str]] | None  # Patterns of the names of each session's jumps; None: no sessions are held out
    mass_kg: float
    pitch_inertia_kgm2: float  # Of the nominal body that residuals correct
    out: str | None = None
    models: list[str] = field(default_factory=lambda: list(MODELS))  # Which of the models to fit, by name
    not_in_sessions: list[str] = field(default_factory=lambda: list(NOT_IN_SESSIONS))
    """Those left out where whole sessions are held out, to save time."""
    folds: int = 4  # Fold f holds out jumps f, f + folds, …
    seed: int = 0
    curvature: float = 0.5  # Curvature of the steps' positions, as in ``rigid_body.advance``, but in published models
    model_settings: dict[str, ModelSettings] = field(default_factory=dict)
    steps_an_epoch: int = 25
    threads: int = 1  # Of torch on the CPU; sums, hence the last bits of the weights, depend on it
    processes: int = 2  # Splits fitted at the same time
    trainer: dict[str, Any] = field(default_factory=lambda: dict(TRAINER))  # Arguments of Lightning's Trainer
    logger: LoggerConfig = field(default_factory=LoggerConfig)
    """What receives the losses along the trainings besides ``curves.csv``; no result depends on it."""

    def __post_init__(self) -> None:
        for name in ("folds", "steps_an_epoch", "threads", "processes"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} {getattr(self, name)}: 1 or more")
        if not (0 < self.mass_kg < math.inf and 0 < self.pitch_inertia_kgm2 < math.inf):
            raise ValueError(f"mass_kg {self.mass_kg}, pitch_inertia_kgm2 {self.pitch_inertia_kgm2}: above 0")
        if not math.isfinite(self.curvature) or self.seed < 0:
            raise ValueError(f"curvature {self.curvature}, seed {self.seed}: a finite number, and 0 or more")

    def models_of(self, split: Split) -> list[str]:
        """Names of the models that are fitted on a split."""
        skipped = self.not_in_sessions if split.name.startswith("session") else []
        judged = bool(split.held_out)  # forecasts are judged, never used
        return [name for name in self.models if name not in skipped and (judged or not recipes()[name].is_forecast)]

    @property
    def body(self) -> RigidBody:
        """The nominal body that residuals correct."""
        return RigidBody(self.mass_kg, self.pitch_inertia_kgm2)


def fit_task(
    config: TrainConfig, split: Split, name: str, train: Windows, held_out: Windows, folder: Path, scratch: Path
) -> FitTask:
    """What a recipe is given for one model of one split; ``folder`` holds the models fitted on the split before."""

    def member(other: str) -> Model:
        models = config.models_of(split)
        is_stored = all((folder / f"{other}.{ending}").is_file() for ending in ("json", "npz"))
        if other not in models[: models.index(name)] or not is_stored:
            raise InputError("train.models", f"{name} before {other}", f"{other} before it", "correct conf/train")
        return load(folder, other).model

    run = TrainingRun(
        config.seed,
        config.threads,
        config.trainer,
        scratch,
        f"{split.name} {name}",
        config.steps_an_epoch,
        config.logger,
        folder.parent,
    )
    return FitTask(train, held_out, config.body, config.curvature, config.model_settings, run, member)


def fit_uncertainty(windows: Windows, config: TrainConfig, recipe: ModelRecipe, path: Path) -> None:
    """Learn the errors of a kernel by leaving out each training jump in turn, and write them."""

    def fit_kernel(train: Windows) -> KernelModel:
        split = Split("", train.jumps, ())
        task = fit_task(config, split, recipe.name, train, train.of_jumps([]), path.parent, path.parent)
        model, _ = recipe.fit(task)
        assert isinstance(model, KernelModel)
        return model

    uncertainty.save(uncertainty.fit(windows, fit_kernel, config.settings(KernelConfig)), path)

"""How each model is fitted to the jumps of a split."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.errors import InputError
from leapgap.learning import kernel, spread, untrained
from leapgap.learning.baselines import ConstantVelocity, NominalModel, Playback, fit_gains
from leapgap.learning.blend import Blend
from leapgap.learning.kernel import KernelConfig, KernelModel
from leapgap.learning.model import Model, Nominal, ResidualModel
from leapgap.learning.network import NetworkForecast, NetworkModel
from leapgap.learning.splits import Split
from leapgap.learning.store import is_stored, load
from leapgap.learning.untrained import Fitting, NetworksConfig, PublishedRecipeConfig
from leapgap.recording.windows import Windows
from leapgap.robot.rigid_body import PUBLISHED, RigidBody

FORECAST = "_forecast"
NO_PHASE = "_no_phase"


@dataclass
class TrainConfig:
    """Section train."""

    windows: str
    out: str | None = None
    models: list[str] = field(default_factory=list)
    """Which of the models to fit, by name."""
    not_in_sessions: list[str] = field(default_factory=list)
    """Those left out where whole sessions are held out, to save time."""
    folds: int = 4
    sessions: list[list[str]] | None = None
    """Patterns of the names of the jumps of each session."""
    seed: int = 0
    mass_kg: float = 12.453
    pitch_inertia_kgm2: float = 0.347
    """Of the nominal body that residuals correct."""
    curvature: float = 0.0
    """Of the steps' positions in all models but the published ones, as in ``rigid_body.advance``."""
    kernel: KernelConfig = field(default_factory=KernelConfig)
    networks: NetworksConfig = field(default_factory=NetworksConfig)
    published_recipe: PublishedRecipeConfig = field(default_factory=PublishedRecipeConfig)
    steps_an_epoch: int = 25
    threads: int = 1
    """Of torch on the CPU; sums, hence the last bits of the weights, depend on it."""
    processes: int = 1
    """Splits fitted at the same time."""
    trainer: dict[str, Any] = field(default_factory=dict)

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
        if name not in task.config.models_of(task.split) or not is_stored(task.folder, name):
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


def fit_spread(windows: Windows, config: TrainConfig, variant: str, path: Path) -> None:
    """By leaving out each training jump in turn."""
    fit = FITS[f"kernel{variant}"]

    def fit_kernel(train: Windows) -> KernelModel:
        split = Split("", train.jumps, ())
        model, _ = fit(Task(config, split, f"kernel{variant}", train, train.of_jumps([]), path.parent, path.parent))
        assert isinstance(model, KernelModel)
        return model

    spread.save(spread.fit(windows, fit_kernel, config.kernel), path)

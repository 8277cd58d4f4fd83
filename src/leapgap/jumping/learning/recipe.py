"""What the pipeline asks of every named model: the base class of recipes, and the task that a recipe fits.

A recipe says how a ``Model`` is fitted, judged, exported and shown. Each is a class in a file of the package
``models``; variants are subclasses there. Names are keys of files and metrics and are never read for a meaning.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from leapgap.jumping.learning.loggers import LoggerConfig
from leapgap.jumping.learning.model import Model
from leapgap.jumping.learning.window_extraction import DeviatingJump
from leapgap.jumping.learning.windows import Windows
from leapgap.jumping.models.rigid_body import DeviationModel, RigidBody

LearningCurve = list[list[float | None]]  # Rows of step, training loss and held-out loss; empty for a fit at once


@dataclass
class ModelSettings:
    """Settings of a kind of models. Subclasses are dataclasses whose fields all have defaults.

    The section ``train.<section>`` of the configuration departs from the defaults; it need not exist.
    """

    section: ClassVar[str]


Settings = TypeVar("Settings", bound=ModelSettings)


class WithModelSettings:
    """Base of what holds settings of models by their section, where they are not the defaults."""

    model_settings: Mapping[str, ModelSettings]

    def settings(self, kind: type[Settings]) -> Settings:
        """The settings of one kind of models."""
        settings = self.model_settings.get(kind.section, kind())
        assert isinstance(settings, kind)
        return settings


@dataclass
class Fitting:
    """How the optimiser moves the weights."""

    steps: int = 120  # Full-batch steps of the optimiser
    learning_rate: float = 0.02
    cosine_decay: bool = True  # Whether the learning rate falls to zero along a cosine
    weight_decay: float = 0.1
    dropout: float = 0.0
    clip_norm: float = 1.0  # Longest gradient; 0: any
    output_penalty: float = 1e-3  # Weight of the mean absolute outputs of h and G (paper, loss)
    loss: str = "mean"  # Of squared errors over windows, steps and components: ``mean``, or ``sum`` as published

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise ValueError("steps of 1 or more")
        if not (0 < self.learning_rate < math.inf and 0 <= self.dropout < 1):
            raise ValueError("a learning_rate above 0, and dropout from 0 up to but not including 1")
        for name in ("weight_decay", "clip_norm", "output_penalty"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} {getattr(self, name)}: 0 or more")


@dataclass(frozen=True)
class TrainingRun:
    """Settings of a gradient descent, whatever it trains."""

    seed: int
    threads: int
    trainer: dict[str, Any]  # Passed to Lightning's Trainer: accelerator, devices, …
    scratch: Path  # Folder of the checkpoints, removed at the end
    title: str  # Shown before the progress bar
    steps_an_epoch: int  # Steps between checkpoints, and between points of the curve
    logger: LoggerConfig = field(default_factory=LoggerConfig)  # What receives the points of the curve
    models: Path = Path()  # Folder of all models, by which a logger groups trainings


@dataclass(frozen=True)
class FitTask(WithModelSettings):
    """The data and settings from which a recipe fits one model of one split."""

    train: Windows
    held_out: Windows  # Looked at for the learning curve only; nothing is chosen by them
    body: RigidBody  # The nominal body that residuals correct
    curvature: float  # Curvature of the steps' positions, as in ``rigid_body.advance``
    model_settings: Mapping[str, ModelSettings]
    run: TrainingRun
    member: Callable[[str], Model]  # Another recipe's model of this split, by name; ``InputError`` without


def configured_inputs(inputs: dict[str, float], uses_phase: bool, uses_feet: bool = True) -> dict[str, float]:
    """The configured inputs of a model with their weights, without the phase or the feet where it does not use them."""
    return {
        name: weight
        for name, weight in inputs.items()
        if (uses_phase or name != "phase") and (uses_feet or "foot" not in name)
    }


class ModelRecipe(ABC):
    """A named model: how it is fitted, judged, exported and shown.

    To add a model, add a subclass in a file of the package ``models``. A subclass of a concrete recipe is a variant.
    """

    name: ClassVar[str]  # Key of its files and of its figures in the metrics
    model: ClassVar[type[Model]]  # The class of the fitted model, which saves and loads itself
    settings: ClassVar[type[ModelSettings] | None] = None  # Its own, which its fit reads; others do not change it
    members: ClassVar[tuple[str, ...]] = ()  # Names of the recipes whose models of the same split its fit reads
    is_forecast: ClassVar[bool] = False
    """Whether it is given no feet and forces measured after the first step. Forecasts are judged on held-out jumps
    and never used, so none is fitted on all jumps."""
    can_be_exported: ClassVar[bool] = True  # Whether it says how forces move the base, which controllers need
    colour: ClassVar[str] = "#555555"  # In figures, as #rrggbb
    label_is_plural: ClassVar[bool] = False  # Whether sentences about it take a plural verb
    shown_by_step: ClassVar[bool] = True  # Whether the figure of errors by step shows it, whose scale large ones spoil
    forecast_name: ClassVar[str | None] = None
    """Key of its figures among the forecasts, where its predictions use nothing measured after the first step."""
    uncertainty_from: ClassVar[str | None] = None  # Recipe whose errors on left-out training jumps count for it
    uncertainty_file: ClassVar[str | None] = None  # Stem of the file of those errors, where they are its own

    @property
    def label(self) -> str:
        """The name as pages show it."""
        return self.name.replace("_", " ")

    @abstractmethod
    def fit(self, task: FitTask) -> tuple[Model, LearningCurve]:
        """Fit the model to the training windows; also the curve of its losses, empty without gradient descent."""


@dataclass(frozen=True)
class DeviationTask(WithModelSettings):
    """The jumps and settings from which a recipe fits one model."""

    jumps: Sequence[DeviatingJump]
    body: RigidBody
    model_settings: Mapping[str, ModelSettings] = field(default_factory=dict)
    seed: int = 0


class DeviationRecipe(ABC):
    """A named model of the deviation from a plan. To add one, add a subclass in a file of the package ``models``."""

    name: ClassVar[str]
    settings: ClassVar[type[ModelSettings] | None] = None  # Settings of its own that its fit reads

    @abstractmethod
    def fit(self, task: DeviationTask) -> DeviationModel:
        """Fit the model to the jumps."""

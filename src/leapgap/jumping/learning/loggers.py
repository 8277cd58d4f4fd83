"""Loggers of trainings: losses along a training in the files of TensorBoard, DVCLive, MLflow or Weights & Biases.

A logger is given the rows of the learning curve and the settings of the fit. Nothing of a training depends on it. All
of them write files and need no network.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from leapgap.errors import needs

PROJECT = "leapgap"  # Project of the runs in Weights & Biases


@dataclass
class LoggerConfig:
    """The section ``train.logger``: logger for training curves besides ``curves.csv``, and its folder."""

    name: str = "csv"  # ``csv`` for ``curves.csv`` alone, or one of ``LOGGERS``
    folder: str = "lightning_logs"  # Outside the output folder: the files hold times, and equal results would differ

    def __post_init__(self) -> None:
        if self.name != "csv" and self.name not in LOGGERS:
            raise ValueError(f"logger {self.name}: one of csv, {', '.join(LOGGERS)}")


def tensorboard(folder: Path, models: Path, run: str) -> Any:
    """Event files in ``<folder>/<models>/<run>/version_<n>``, a new version for every training."""
    with needs("tensorboard"):
        import tensorboard as _  # noqa: F401  Lightning's own message names no extra of ours
    from lightning.pytorch.loggers import TensorBoardLogger

    return TensorBoardLogger(folder, f"{models}/{run}", default_hp_metric=False)


def dvclive(folder: Path, models: Path, run: str) -> Any:
    """Tables in ``<folder>/<models>/<run>/plots``; no experiment of DVC is saved, since a stage is one already."""
    with needs("dvclive"):
        from dvclive.lightning import DVCLiveLogger

    return DVCLiveLogger(run, dir=str(folder / models / run), save_dvc_exp=False, dvcyaml=None)


def mlflow(folder: Path, models: Path, run: str) -> Any:
    """A run of the experiment ``<models>`` in the SQLite file ``<folder>/mlflow.db``."""
    with needs("mlflow"):
        import mlflow as client
    from lightning.pytorch.loggers import MLFlowLogger

    folder.mkdir(parents=True, exist_ok=True)
    store = f"sqlite:///{folder.resolve() / 'mlflow.db'}"
    experiments = client.MlflowClient(store)
    if experiments.get_experiment_by_name(str(models)) is None:
        experiments.create_experiment(str(models), artifact_location=(folder / "mlartifacts").resolve().as_uri())
    return MLFlowLogger(str(models), run, tracking_uri=store)


def wandb(folder: Path, models: Path, run: str) -> Any:
    """An offline run of the group ``<models>`` in ``<folder>/wandb``; ``wandb sync`` uploads it if you like."""
    with needs("wandb"):
        import wandb as client
    from lightning.pytorch.loggers import WandbLogger

    quiet = client.Settings(silent=True, console="off", x_disable_stats=True, disable_git=True, disable_code=True)
    # The whole path: the process that writes may have been started in another working folder.
    return WandbLogger(run, folder.resolve(), offline=True, project=PROJECT, group=str(models), settings=quiet)


LOGGERS: Mapping[str, Callable[[Path, Path, str], Any]] = {
    "tensorboard": tensorboard,
    "dvclive": dvclive,
    "mlflow": mlflow,
    "wandb": wandb,
}
"""Makers of Lightning's loggers by name: from the folder of the logs, that of the models, and the name of a run."""


def make_logger(config: LoggerConfig, models: Path, run: str) -> Any:
    """Lightning's logger for one training; None where ``curves.csv`` is all that is asked for.

    ``models`` is the folder of the models, which names the group of the run. ``InputError`` where a package is missing.
    """
    if config.name == "csv":
        return None
    return LOGGERS[config.name](Path(config.folder), place_of(models), run)


def place_of(models: Path) -> Path:
    """The folder of the models relative to the working folder, or its whole path without the root."""
    whole, here = models.resolve(), Path.cwd()
    return whole.relative_to(here if whole.is_relative_to(here) else whole.anchor)


def close(loggers: Iterable[Any]) -> None:
    """End the runs. Weights & Biases would otherwise take the next training of this process for the same run."""
    for logger in loggers:
        if type(logger).__name__ == "WandbLogger":
            logger.experiment.finish()

"""Training of residual networks with Lightning: the optimiser, the callbacks and the fit (paper, training).

It moves the weights of a ``NetworkModel`` in full batches and hands back another one. The loss is over the horizon
of the windows. ``DeviationNetworks`` are trained on roll-outs along their jumps.
"""

import logging
import shutil
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import lightning
import numpy as np
import torch
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.callbacks import Callback, ModelCheckpoint

from leapgap.errors import InputError
from leapgap.jumping.learning import loggers
from leapgap.jumping.learning.models.kernel import mode_of, places
from leapgap.jumping.learning.models.residual_networks import DeviationNetworks
from leapgap.jumping.learning.network import NETWORKS, Mlp, NetworkModel, Scaling
from leapgap.jumping.learning.recipe import Fitting, LearningCurve, TrainingRun
from leapgap.jumping.learning.window_extraction import BALLISTIC_S, DeviatingJump
from leapgap.jumping.learning.windows import Windows
from leapgap.jumping.models.rigid_body import CURVATURE, GRAVITY, Situation, selection
from leapgap.logs.pair_force import per_axis


@dataclass(frozen=True)
class Batch:
    """All windows as tensors, sorted by their start, so that at each step those in contact come first."""

    state: torch.Tensor
    force: torch.Tensor
    foot: torch.Tensor
    time_s: torch.Tensor
    step_s: torch.Tensor
    in_contact: list[int]  # How many windows begin step k before take-off, for each k

    @staticmethod
    def of(windows: Windows, device: torch.device, part: slice = slice(None)) -> "Batch":
        """Windows on a device in single precision; of several devices each takes its ``part``."""
        inputs, order = windows.inputs, np.argsort(windows.start, kind="stable")[part]

        arrays = (windows.state, inputs.force, inputs.foot, inputs.time_s, inputs.step_s)
        state, *acting = (torch.tensor(array[order], dtype=torch.float32, device=device) for array in arrays)
        force, foot, time_s, step_s = acting
        return Batch(state, force, foot, time_s, step_s, inputs.contact[order].sum(axis=0).tolist())


class Networks(torch.nn.ModuleDict):
    """The trainable twins of perceptrons by name, each of S members side by side."""

    def __init__(self, networks: Mapping[str, Mlp]) -> None:
        super().__init__()
        for name, mlp in networks.items():
            layers = zip(mlp.weights, mlp.biases, strict=True)
            pairs = [torch.nn.ParameterList([torch.nn.Parameter(torch.tensor(a)) for a in layer]) for layer in layers]
            self[name] = torch.nn.ModuleList(pairs)

    def run(self, name: str, hidden: torch.Tensor, dropout: float = 0.0) -> torch.Tensor:
        """One network, (S, n, f) → (S, n, outputs)."""
        layers: Any = self[name]
        for weight, bias in layers[:-1]:
            hidden = torch.tanh(torch.baddbmm(bias, hidden, weight))
            if dropout and self.training:
                hidden = torch.nn.functional.dropout(hidden, dropout)
        weight, bias = layers[-1]
        return torch.baddbmm(bias, hidden, weight)

    def mlps(self) -> dict[str, Mlp]:
        """The perceptrons with the weights of this module."""
        layers: dict[str, Any] = dict(self.items())
        return {
            name: Mlp(*(tuple(one[i].detach().cpu().numpy().copy() for one in of_name) for i in (0, 1)))
            for name, of_name in layers.items()
        }


class ResidualModule(torch.nn.Module):
    """The trainable twin of ``NetworkModel``: S members side by side, single precision."""

    def __init__(self, model: NetworkModel, dropout: float) -> None:
        super().__init__()
        self.dropout, self.networks = dropout, Networks({name: model.networks[name] for name in NETWORKS})
        for phase, part in (("contact", model.contact), ("flight", model.flight)):
            for name in Scaling.__dataclass_fields__:
                self.register_buffer(f"{phase}_{name}", torch.tensor(getattr(part, name), dtype=torch.float32))
            scaled = selection(model.names) / part.input_scale
            self.register_buffer(f"{phase}_select", torch.tensor(scaled, dtype=torch.float32))
            shift = torch.tensor(part.input_mean / part.input_scale, dtype=torch.float32)
            self.register_buffer(f"{phase}_shift", shift)
        self.curvature = model.nominal.curvature
        body = model.nominal.body
        by_force = np.asarray(model.nominal.gains) / [body.mass_kg, body.mass_kg, body.pitch_inertia_kgm2]
        self.by_force: torch.Tensor
        self.gravity: torch.Tensor
        self.register_buffer("by_force", torch.tensor(by_force, dtype=torch.float32))
        self.register_buffer("gravity", torch.tensor([0.0, -GRAVITY, 0.0]))

    def nominal(self, foot: torch.Tensor, force: torch.Tensor) -> torch.Tensor:
        """Accelerations of the nominal body with its gains, (n, 3)."""
        (rx, rz, sx, sz), (fx, fz, gx, gz) = foot.T, force.T  # front, then rear
        pushed = torch.stack([fx + gx, fz + gz, rz * fx - rx * fz + sz * gx - sx * gz], dim=-1)
        return pushed * self.by_force + self.gravity

    def forward(self, situation: Situation, force: torch.Tensor, pushing: bool) -> tuple[torch.Tensor, torch.Tensor]:
        """Accelerations (S, n, 3) in one phase, and the summed mean absolute outputs for the penalty.

        The situation's state and start are (S, n, 6), its foot and the force (n, 4): measured, the same for all.
        """
        phase = "contact" if pushing else "flight"
        members = situation.state.shape[0]
        measured = torch.cat([situation.foot, situation.time_s[:, None]], dim=-1).expand(members, -1, -1)
        known = torch.cat([situation.state, situation.start, measured], dim=-1)
        scaling = {
            name: getattr(self, f"{phase}_{name}") for name in (*Scaling.__dataclass_fields__, "select", "shift")
        }
        inputs = known @ scaling["select"] - scaling["shift"]
        raw = self.networks.run(f"{phase}/h", inputs, self.dropout)
        penalty = raw.abs().mean(dim=(1, 2)).sum()
        if pushing:
            raw_g = self.networks.run("contact/G", inputs, self.dropout)
            penalty = penalty + raw_g.abs().mean(dim=(1, 2)).sum()
            scaled = (force - scaling["force_mean"]) / scaling["force_scale"]
            raw = raw + (raw_g.unflatten(-1, (3, 4)) * scaled[:, None, :]).sum(dim=-1)
        return raw * scaling["scale"] + scaling["mean"] + self.nominal(situation.foot, force), penalty

    def roll_out(self, batch: Batch) -> tuple[torch.Tensor, torch.Tensor]:
        """Each member's states after each step, (S, W, K, 6), and the penalty, mean over the steps."""
        members = len(self.networks["contact/h"][0][0])  # type: ignore[index]
        start = batch.state[:, 0].expand(members, -1, -1)
        state, states, penalty = start, [], torch.zeros((), device=start.device)
        for k, contact in enumerate(batch.in_contact):
            accelerations = []
            for pushing, part in ((True, slice(0, contact)), (False, slice(contact, None))):
                if state[0, part].shape[0]:
                    situation = Situation(state[:, part], batch.foot[part, k], batch.time_s[part, k], start[:, part])
                    found, outputs = self(situation, batch.force[part, k], pushing)
                    accelerations.append(found)
                    penalty = penalty + outputs * (state[0, part].shape[0] / len(batch.state))
            dt = batch.step_s[:, k, None]
            velocity, gained = state[..., 3:], dt * torch.cat(accelerations, dim=1)
            state = torch.cat([state[..., :3] + dt * (velocity + self.curvature * gained), velocity + gained], dim=-1)
            states.append(state)
        return torch.stack(states, dim=2), penalty / len(batch.in_contact)


DIVERGED, LEAST_LOSS = 1e4, 1e-6
"""A training diverges if its loss is this many times that of its first step; a smaller first loss counts as this."""
MOST_WINDOWS = 4096
"""Largest number of windows that are trained on, and looked at for a curve; memory grows with their number. It is that
of 150 jumps; of more jumps, windows spread evenly are taken."""
CURVE = ("step", "train_loss", "validation_loss")


class Trainable(lightning.LightningModule):
    """What Lightning trains, with its optimiser."""

    def __init__(self, fitting: Fitting) -> None:
        super().__init__()
        self.fitting = fitting

    def configure_optimizers(self) -> Any:
        """AdamW, with the learning rate along a cosine where that is configured."""
        fitting = self.fitting
        optimiser = torch.optim.AdamW(self.parameters(), lr=fitting.learning_rate, weight_decay=fitting.weight_decay)
        if not fitting.cosine_decay:
            return optimiser
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, fitting.steps)
        return {"optimizer": optimiser, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}


class Learner(Trainable):
    """The residual and its loss."""

    def __init__(self, residual: ResidualModule, windows: Sequence[Windows], fitting: Fitting, seed: int) -> None:
        super().__init__(fitting)
        self.residual, self.seed = residual, seed
        self.windows, self.batches = windows, list[Batch]()
        """Those trained on, then maybe held-out ones, which are looked at for the curve."""

    def setup(self, stage: str) -> None:
        """Put the windows where the weights are; with several devices, each takes every n-th window."""
        mine = slice(self.trainer.global_rank, None, self.trainer.world_size)
        device, parts = self.trainer.strategy.root_device, (mine, slice(None))
        self.batches = [Batch.of(windows, device, part) for windows, part in zip(self.windows, parts, strict=False)]

    def training_step(self, *_: Any) -> torch.Tensor:
        """Squared errors over the horizon, summed over the members, and the penalty of the outputs.

        Dropout is seeded again at each step, so that a resumed training ends in the same bits.
        """
        torch.manual_seed((self.seed << 32) + (self.global_step << 8) + self.global_rank)
        batch = self.batches[0]
        states, penalty = self.residual.roll_out(batch)
        squared = (states - batch.state[:, 1:]) ** 2
        per_member = squared.mean(dim=(1, 2, 3)) if self.fitting.loss == "mean" else squared.sum(dim=(1, 2, 3))
        self.log("train_loss", squared.mean().detach(), batch_size=1, logger=False)  # LossCurve gives it to loggers
        return per_member.sum() + self.fitting.output_penalty * penalty

    def held_out_error(self) -> float | None:
        """Mean squared error of the members' mean path on held-out windows, if there are such."""
        if len(self.batches) < 2:
            return None
        self.eval()
        with torch.no_grad():
            states, _ = self.residual.roll_out(self.batches[1])
        self.train()
        return float(((states.mean(dim=0) - self.batches[1].state[:, 1:]) ** 2).mean())


class EmptySteps(torch.utils.data.IterableDataset):
    """One empty item a step: the data are in memory already."""

    def __init__(self, steps: int) -> None:
        self.steps = steps

    def __iter__(self) -> Iterator[int]:
        yield from range(self.steps)

    def __len__(self) -> int:
        return self.steps


class LossCurve(Callback):
    """Losses along the training, in the checkpoint too."""

    def __init__(self, every: int, title: str) -> None:
        self.every, self.title = every, title
        self.rows: LearningCurve = []
        self.first = float("inf")  # Loss of the first step

    def on_train_batch_end(self, trainer: lightning.Trainer, pl_module: lightning.LightningModule, *_: Any) -> None:
        """Note the losses, before the checkpoint of the same step is written."""
        step, loss = trainer.global_step, float(trainer.callback_metrics["train_loss"])
        self.first = loss if step == 1 else self.first
        if (step == 1 or step % self.every == 0) and not loss <= DIVERGED * max(self.first, LEAST_LOSS):
            found = f"a loss of {loss:.3g} after {step} steps, {self.first:.3g} at the start"
            do = "lower fitting.learning_rate of this model, or set its fitting.clip_norm"
            raise InputError(f"training of {self.title}", found, "a loss that falls", do)
        if step % self.every == 0 or step == trainer.max_steps:
            assert isinstance(pl_module, Learner)
            self.rows.append([step, loss, pl_module.held_out_error()])
            losses = dict(zip(CURVE[1:], self.rows[-1][1:], strict=True))
            for logger in trainer.loggers:
                logger.log_metrics({name: value for name, value in losses.items() if value is not None}, step=step)

    def state_dict(self) -> dict[str, Any]:
        """The rows so far, for the checkpoint."""
        return {"rows": self.rows, "first": self.first}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Take the rows from the checkpoint."""
        self.rows, self.first = list(state_dict["rows"]), state_dict["first"]


def fit(
    model: NetworkModel, train: Windows, held_out: Windows | None, fitting: Fitting, run: TrainingRun
) -> tuple[NetworkModel, LearningCurve]:
    """Train from a model's weights; the trained one and its curve (rows of ``CURVE``).

    A killed run goes on from its last checkpoint. Held-out windows are looked at for the curve, and nothing is
    chosen by them.
    """
    if fitting.loss not in ("mean", "sum"):
        raise InputError("train, fitting.loss", fitting.loss, "mean or sum", "correct it in conf/train")
    silence_advice()
    torch.set_num_threads(run.threads)
    lightning.seed_everything(run.seed, verbose=False)
    windows = [one.thin(MOST_WINDOWS) for one in (train, held_out) if one is not None]
    learner = Learner(ResidualModule(model, fitting.dropout), windows, fitting, run.seed)
    every = min(run.steps_an_epoch, fitting.steps)
    curve, last = LossCurve(every, run.title), run.scratch / "last.ckpt"
    checkpoint = ModelCheckpoint(run.scratch, "last", every_n_train_steps=every, enable_version_counter=False)
    options: dict[str, Any] = {"accelerator": "cpu", "devices": 1, "deterministic": True, **run.trainer}
    # A log file wants no bars.
    options["enable_progress_bar"] = options.get("enable_progress_bar", True) and sys.stderr.isatty()
    try:
        driver = new_trainer(
            fitting,
            default_root_dir=run.scratch,
            logger=loggers.make_logger(run.logger, run.models, run.title.replace(" ", "/")) or False,
            log_every_n_steps=every,
            use_distributed_sampler=False,
            callbacks=[curve, checkpoint],
            **options,
        )
    except (TypeError, ValueError, MisconfigurationException) as error:
        expected = "options of lightning.Trainer this machine can serve"
        raise InputError("train.trainer", str(error), expected, "correct conf/train") from None
    steps = torch.utils.data.DataLoader(EmptySteps(every), batch_size=None)
    for logger in driver.loggers:
        logger.log_hyperparams({**asdict(fitting), "seed": run.seed})
    try:
        driver.fit(learner, steps, ckpt_path=str(last) if last.exists() else None, weights_only=True)
    finally:
        loggers.close(driver.loggers)
    shutil.rmtree(run.scratch, ignore_errors=True)
    return replace(model, networks=learner.residual.networks.mlps()), curve.rows


def new_trainer(fitting: Fitting, **options: Any) -> lightning.Trainer:
    """Lightning's driver of a fit, with further options."""
    clip = fitting.clip_norm or None
    return lightning.Trainer(max_steps=fitting.steps, gradient_clip_val=clip, enable_model_summary=False, **options)


def silence_advice() -> None:
    """Silence advice of Lightning that does not fit full batches in memory."""
    logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
    for about in (
        ".*does not have many workers.*",
        ".*exists and is not empty.*",
        ".*IterableDataset.*",
        ".*isinstance.*LeafSpec.*",
        ".*number of training batches.*",
    ):
        warnings.filterwarnings("ignore", about)


ERROR_SCALE = (0.02, 0.02, 0.05, 0.1, 0.1, 0.4)  # Errors of a prediction that count alike, m, rad, s


class RollOuts(Trainable):
    """All jumps as tensors, the networks, and the loss of their roll-outs from every step."""

    def __init__(
        self, start: DeviationNetworks, jumps: Sequence[DeviatingJump], horizon: int, fitting: Fitting
    ) -> None:
        super().__init__(fitting)
        learned = int((jumps[0].steps.time_s < start.landing_s - BALLISTIC_S - 1e-6).sum())
        self.horizon = min(horizon, learned)
        self.starts = learned - self.horizon + 1
        self.networks = Networks(start.networks)
        self.members = len(next(iter(start.networks.values())).weights[0])
        steps = [jump.steps for jump in jumps]
        force = np.stack([jump.force * per_axis(jump.steps.pushing) for jump in jumps])[:, :learned]
        rows = np.stack([start.body.force_rows(one.foot) for one in steps])[:, :learned]
        modes = np.stack([mode_of(one)[:learned] for one in steps]).ravel()
        self.of_mode = {name: torch.tensor(np.flatnonzero(modes == name)) for name in start.networks}
        for name, values in {
            "inputs": np.stack([places(one, start.scale)[:learned] for one in steps]).reshape(-1, len(start.scale)),
            "error": np.stack([jump.error for jump in jumps])[:, : learned + 1],
            "force": force,
            "of_body": np.einsum("jkab,jkb->jka", rows, force),
            "step_s": np.stack([jump.step_s for jump in jumps])[:, :learned],
            "weight": np.array([jump.weight for jump in jumps]),
            "unit": start.acceleration_unit[:, None] / start.unit,
            "scale": np.array(ERROR_SCALE),
        }.items():
            self.register_buffer(name, torch.tensor(values, dtype=torch.float32))

    def coefficients(self) -> torch.Tensor:
        """h, C and G of each member at every step of every jump, (S, jumps, steps, 3, 11), without units."""
        found = torch.zeros(self.members, len(self.inputs), self.unit.numel())
        for name, at in self.of_mode.items():
            raw = self.networks.run(name, self.inputs[at].expand(self.members, -1, -1))
            found = found.index_copy(1, at, raw)
        return found.unflatten(1, self.force.shape[:2]).unflatten(-1, self.unit.shape)

    def training_step(self, *_: Any) -> torch.Tensor:
        """Mean squared errors over horizon and components, weighted by jump, summed over members, and the penalty."""
        raw = self.coefficients()
        affine, count = raw * self.unit, self.starts
        state = self.error[:, :count].expand(len(raw), -1, -1, -1)  # (S, jumps, starts, 6)
        total = torch.zeros(())
        for k in range(self.horizon):
            part = slice(k, k + count)
            ones = torch.ones_like(state[..., :1])
            known = torch.cat([ones, state, self.force[:, part].expand(len(raw), -1, -1, -1)], dim=-1)
            acceleration = self.of_body[:, part] + (affine[:, :, part] * known[..., None, :]).sum(dim=-1)
            dt = self.step_s[:, part, None]
            velocity, gained = state[..., 3:], dt * acceleration
            state = torch.cat([state[..., :3] + dt * (velocity + CURVATURE * gained), velocity + gained], dim=-1)
            off = (state - self.error[:, k + 1 : k + 1 + count]) / self.scale
            total = total + (off.pow(2).mean(dim=(2, 3)) * self.weight / self.weight.mean()).mean(dim=1).sum()
        return total / self.horizon + self.fitting.output_penalty * raw.abs().mean() * len(raw)


def fit_deviation(
    start: DeviationNetworks, jumps: Sequence[DeviatingJump], horizon: int, fitting: Fitting, seed: int
) -> DeviationNetworks:
    """Train from the weights of ``start``; the same jumps, settings and seed give the same weights."""
    silence_advice()
    torch.set_num_threads(1)
    lightning.seed_everything(seed, verbose=False)
    learner = RollOuts(start, jumps, horizon, fitting)
    quiet = {"logger": False, "enable_checkpointing": False, "enable_progress_bar": False}
    trainer = new_trainer(fitting, accelerator="cpu", devices=1, deterministic=True, **quiet)
    trainer.fit(learner, torch.utils.data.DataLoader(EmptySteps(fitting.steps), batch_size=None))
    return replace(start, networks=learner.networks.mlps())

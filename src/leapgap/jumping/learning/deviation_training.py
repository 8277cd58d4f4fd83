"""Training of ``DeviationNetworks`` with Lightning: full batches of roll-outs over the horizon."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import lightning
import numpy as np
import torch

from leapgap.jumping.learning.models.kernel import mode_of, places
from leapgap.jumping.learning.models.residual_networks import DeviationNetworks
from leapgap.jumping.learning.recipe import Fitting
from leapgap.jumping.learning.training import EmptySteps, Networks, optimiser_of, silence_advice
from leapgap.jumping.learning.window_extraction import BALLISTIC_S, DeviatingJump
from leapgap.jumping.models.rigid_body import CURVATURE
from leapgap.logs.pair_force import per_axis

ERROR_SCALE = (0.02, 0.02, 0.05, 0.1, 0.1, 0.4)  # Errors of a prediction that count alike, m, rad, s


class RollOuts(lightning.LightningModule):
    """All jumps as tensors, the networks, and the loss of their roll-outs from every step."""

    def __init__(
        self, start: DeviationNetworks, jumps: Sequence[DeviatingJump], horizon: int, fitting: Fitting
    ) -> None:
        super().__init__()
        self.fitting = fitting
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

    def configure_optimizers(self) -> Any:
        """As for the other networks."""
        return optimiser_of(self.parameters(), self.fitting)


def fit(
    start: DeviationNetworks, jumps: Sequence[DeviatingJump], horizon: int, fitting: Fitting, seed: int
) -> DeviationNetworks:
    """Train from the weights of ``start``; the same jumps, settings and seed give the same weights."""
    silence_advice()
    torch.set_num_threads(1)
    lightning.seed_everything(seed, verbose=False)
    learner = RollOuts(start, jumps, horizon, fitting)
    trainer = lightning.Trainer(
        max_steps=fitting.steps,
        gradient_clip_val=fitting.clip_norm or None,
        accelerator="cpu",
        devices=1,
        deterministic=True,
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    trainer.fit(learner, torch.utils.data.DataLoader(EmptySteps(fitting.steps), batch_size=None))
    return replace(start, networks=learner.networks.mlps())

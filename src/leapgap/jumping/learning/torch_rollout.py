"""Residual networks in torch: batches of windows, and roll-outs that gradients pass through.

The trainable twin of ``network``; ``training`` moves its weights. Only these two modules import torch.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from leapgap.jumping.learning.network import NETWORKS, Mlp, NetworkModel, Scaling
from leapgap.jumping.learning.windows import Windows
from leapgap.jumping.models.affine_model import Situation, selection
from leapgap.jumping.models.rigid_body import GRAVITY
from leapgap.logs.pair_force import FRONT_X, FRONT_Z, REAR_X, REAR_Z


@dataclass(frozen=True)
class Batch:
    """All windows as tensors, sorted by their start, so that at each step those in contact come first."""

    state: torch.Tensor
    force: torch.Tensor
    foot: torch.Tensor
    time_s: torch.Tensor
    step_s: torch.Tensor
    in_contact: list[int]
    """How many windows begin step k before take-off, for each k."""

    @staticmethod
    def of(windows: Windows, device: torch.device, part: slice = slice(None)) -> "Batch":
        """Windows on a device in single precision; of several devices each takes its ``part``."""
        inputs, order = windows.inputs, np.argsort(windows.start, kind="stable")[part]

        def tensor(array: np.ndarray) -> torch.Tensor:
            return torch.tensor(array[order], dtype=torch.float32, device=device)

        return Batch(
            tensor(windows.state),
            tensor(inputs.force),
            tensor(inputs.foot),
            tensor(inputs.time_s),
            tensor(inputs.step_s),
            inputs.contact[order].sum(axis=0).tolist(),
        )


class ResidualModule(torch.nn.Module):
    """The trainable twin of ``NetworkModel``: S members side by side, single precision."""

    def __init__(self, model: NetworkModel, dropout: float) -> None:
        super().__init__()
        self.dropout = dropout
        self.networks = torch.nn.ModuleDict()
        for name in NETWORKS:
            layers = zip(model.networks[name].weights, model.networks[name].biases, strict=True)
            pairs = [torch.nn.ParameterList([torch.nn.Parameter(torch.tensor(a)) for a in layer]) for layer in layers]
            self.networks[name] = torch.nn.ModuleList(pairs)
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
        pushed = torch.stack(
            [
                force[:, FRONT_X] + force[:, REAR_X],
                force[:, FRONT_Z] + force[:, REAR_Z],
                foot[:, FRONT_Z] * force[:, FRONT_X]
                - foot[:, FRONT_X] * force[:, FRONT_Z]
                + foot[:, REAR_Z] * force[:, REAR_X]
                - foot[:, REAR_X] * force[:, REAR_Z],
            ],
            dim=-1,
        )
        return pushed * self.by_force + self.gravity

    def forward(self, situation: Situation, force: torch.Tensor, pushing: bool) -> tuple[torch.Tensor, torch.Tensor]:
        """Accelerations (S, n, 3) in one phase, and the summed mean absolute outputs for the penalty.

        The situation's state and start are (S, n, 6), its foot and the force (n, 4): measured, the same for all.
        """
        phase = "contact" if pushing else "flight"
        members = situation.state.shape[0]
        measured = torch.cat([situation.foot, situation.time_s[:, None]], dim=-1).expand(members, -1, -1)
        known = torch.cat([situation.state, situation.start, measured], dim=-1)
        inputs = known @ self.scaling(phase, "select") - self.scaling(phase, "shift")
        raw = self.mlp(f"{phase}/h", inputs)
        penalty = raw.abs().mean(dim=(1, 2)).sum()
        if pushing:
            raw_g = self.mlp("contact/G", inputs)
            penalty = penalty + raw_g.abs().mean(dim=(1, 2)).sum()
            scaled = (force - self.scaling(phase, "force_mean")) / self.scaling(phase, "force_scale")
            raw = raw + (raw_g.unflatten(-1, (3, 4)) * scaled[:, None, :]).sum(dim=-1)
        residual = raw * self.scaling(phase, "scale") + self.scaling(phase, "mean")
        return residual + self.nominal(situation.foot, force), penalty

    def scaling(self, phase: str, name: str) -> torch.Tensor:
        """One array of a phase's ``Scaling`` by its name, or ``select`` and ``shift`` that scale the inputs."""
        return getattr(self, f"{phase}_{name}")

    def mlp(self, name: str, hidden: torch.Tensor) -> torch.Tensor:
        """One network, (S, n, f) → (S, n, outputs)."""
        layers: Any = self.networks[name]
        for weight, bias in layers[:-1]:
            hidden = torch.tanh(torch.baddbmm(bias, hidden, weight))
            if self.dropout and self.training:
                hidden = torch.nn.functional.dropout(hidden, self.dropout)
        weight, bias = layers[-1]
        return torch.baddbmm(bias, hidden, weight)

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

    def to_model(self, start: NetworkModel) -> NetworkModel:
        """``start`` with the weights of this module."""
        networks = {}
        for name in NETWORKS:
            layers: Any = self.networks[name]
            networks[name] = Mlp(*(tuple(layer[i].detach().cpu().numpy().copy() for layer in layers) for i in (0, 1)))
        return replace(start, networks=networks)

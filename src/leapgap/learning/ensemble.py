"""The mean of several residual models: their errors differ, so the mean's is smaller."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from leapgap.learning.kernel import KernelModel
from leapgap.learning.model import Nominal, ResidualModel
from leapgap.learning.network import NetworkModel
from leapgap.robot.prediction import Affine, Situation

KINDS: dict[str, type[ResidualModel]] = {kind.kind: kind for kind in (KernelModel, NetworkModel)}


@dataclass(frozen=True)
class Blend(ResidualModel):
    """Accelerations are the members' mean, so it is affine in the force as they are."""

    kind: ClassVar[str] = "blend"
    members: tuple[ResidualModel, ...]

    @property
    def nominal(self) -> Nominal:  # type: ignore[override]
        """Of the first member; the residual is counted from it."""
        return self.members[0].nominal

    def affine(self, situation: Situation, contact: np.ndarray) -> Affine:
        """Mean of the members."""
        found = [member.affine(situation, contact) for member in self.members]
        return Affine(np.mean([f.bias for f in found], axis=0), np.mean([f.by_force for f in found], axis=0))

    def residual(self, situation: Situation, contact: np.ndarray) -> Affine:
        """What is beyond the nominal body."""
        whole, nominal = self.affine(situation, contact), self.nominal.at(situation.foot)
        return Affine(whole.bias - nominal.bias, whole.by_force - nominal.by_force)

    def arrays(self) -> dict[str, np.ndarray]:
        """The members' arrays, as ``0/…``."""
        return {f"{i}/{name}": a for i, member in enumerate(self.members) for name, a in member.arrays().items()}

    def settings(self) -> dict[str, Any]:
        """The members' kinds and settings."""
        return {"members": [{"kind": member.kind, "settings": member.settings()} for member in self.members]}

    @classmethod
    def from_parts(cls, arrays: dict[str, np.ndarray], settings: dict[str, Any]) -> "Blend":
        """Read back."""
        members = []
        for i, about in enumerate(settings["members"]):
            mine = {name.removeprefix(f"{i}/"): a for name, a in arrays.items() if name.startswith(f"{i}/")}
            members.append(KINDS[about["kind"]].from_parts(mine, about["settings"]))
        return cls(tuple(members))  # type: ignore[arg-type]

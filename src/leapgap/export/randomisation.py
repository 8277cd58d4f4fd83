"""Ranges to randomise over, for any simulator: by number of the diagnosis, joint, body and foot."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from leapgap.export.base import DRAWN, CorrectedRobot, Export, shorter
from leapgap.runtime.atomic_io import whole_file, write_text

SAMPLES = "posterior.npz"
HEAD = f"""\
# 95 % intervals of the numbers that the diagnosis identified, as ranges to randomise over; SI units.
# A number that is not here is as in robot.xml: these logs do not change it.
# Numbers that the logs tell only together must be drawn together: {SAMPLES} holds {DRAWN} robots, one a row.
"""


class Randomisation(Export):
    """Ranges of the identified numbers as YAML, for simulators without a file of their own here."""

    name = "randomisation.yaml"
    says = "95 % ranges of the identified numbers, by joint, body and foot"

    def write(self, folder: Path, corrected: CorrectedRobot) -> None:
        """Write numbers with their correlations, and the ranges by joint, body and foot."""
        posterior = corrected.posterior
        spread = np.sqrt(np.diag(posterior.covariance))
        with np.errstate(divide="ignore", invalid="ignore"):
            correlation = np.nan_to_num(posterior.covariance / np.outer(spread, spread))
        content: dict[str, Any] = {
            "numbers": {
                label: {"value": shorter(value), "standard_deviation": shorter(own)}
                for label, value, own in zip(posterior.labels, posterior.mean, spread, strict=True)
            },
            "correlation": [[round(float(one), 3) for one in row] for row in correlation],
            **{"joints": {}, "bodies": {}, "feet": {"friction": {}}},
        }
        for kind, ranges in corrected.ranges.items():
            content[kind] |= {key: {name: one.rounded() for name, one in of.items()} for key, of in ranges.items()}
        text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)
        write_text(folder / self.name, HEAD + text)


class Samples(Export):
    """Robots drawn from the posterior."""

    name = SAMPLES
    says = (
        f"{DRAWN} robots drawn together from what the logs leave undetermined (`numpy.load`): a row a robot, "
        "a column a joint, body or foot"
    )

    def write(self, folder: Path, corrected: CorrectedRobot) -> None:
        """Write the drawn numbers, what follows from them, and the names of the columns."""
        names = {
            "numbers_of": np.array(corrected.posterior.labels, dtype=str),
            "joints": np.array(corrected.robot.joints, dtype=str),
            "bodies": np.array(corrected.body_names, dtype=str),
            "feet": np.array(corrected.robot.foot_geom_names, dtype=str),
        }
        with whole_file(folder / self.name) as path, path.open("wb") as file:
            np.savez_compressed(file, **(names | {"numbers": corrected.drawn} | corrected.arrays))  # type: ignore[arg-type]

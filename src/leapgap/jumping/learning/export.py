"""Trained models for use outside of learning: NumPy arrays for ``control.inference``, and ONNX for anybody else.

The arrays are those of the model's flat form (``flat_model``).
"""

from dataclasses import asdict
from pathlib import Path

import numpy as np

from leapgap.jumping.learning.model import ResidualModel
from leapgap.jumping.learning.npz_files import write_npz
from leapgap.jumping.learning.store import StoredModel
from leapgap.jumping.models.affine_model import KNOWN
from leapgap.runtime.atomic_io import whole_file, write_json

FORMAT_VERSION = 2


def write(stored: StoredModel, folder: Path, name: str, deviation: np.ndarray | None = None) -> None:
    """Write ``<name>.npz``, ``<name>.onnx`` and, last, ``<name>.json``.

    ``deviation``: of predicted states by start of the prediction and step, (starts, K, 6), where known.
    """
    phases = stored.model.flatten()
    assert isinstance(stored.model, ResidualModel)  # else ``flatten`` has refused it
    arrays = {} if deviation is None else {"deviation": deviation}
    for phase, flat in phases.items():
        arrays |= {f"{phase}/constant": flat.constant, f"{phase}/feet": flat.feet}
        for i, part in enumerate(flat.parts):
            arrays |= {f"{phase}/{i}/{key}": array for key, array in part.arrays.items()}
    about = {
        "format_version": FORMAT_VERSION,
        "model": name,
        "key": stored.key,
        "curvature": stored.model.curvature,
        "inputs": list(getattr(stored.model, "names", ())),
        "trained_on": list(stored.trained_on),
        **asdict(stored.purpose),
        "parts": {phase: [part.kind for part in flat.parts] for phase, flat in phases.items()},
    }
    folder.mkdir(parents=True, exist_ok=True)
    with whole_file(folder / f"{name}.npz") as beside:
        write_npz(beside, arrays)
    from leapgap.jumping.learning import onnx_graph  # onnx is imported only where it is written

    with whole_file(folder / f"{name}.onnx") as beside:
        beside.write_bytes(onnx_graph.serialise(phases, about, KNOWN))
    write_json(folder / f"{name}.json", about)

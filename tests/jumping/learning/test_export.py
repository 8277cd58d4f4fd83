"""Exported models: the NumPy reader and ONNX against the models they were made of."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import onnxruntime
import pytest

from leapgap.errors import InputError
from leapgap.jumping.control import inference
from leapgap.jumping.learning import store, training
from leapgap.jumping.learning.model import Nominal
from leapgap.jumping.learning.models import kernel
from leapgap.jumping.learning.models.ensemble import ModelEnsemble
from leapgap.jumping.learning.models.kernel import KernelConfig
from leapgap.jumping.learning.models.nominal import NominalModel, Playback, fit_gains
from leapgap.jumping.learning.models.residual_networks import (
    NetworksConfig,
    PublishedRecipeConfig,
    initial_networks,
    initial_published_networks,
)
from leapgap.jumping.learning.windows import Purpose, TimeGrid, Windows
from leapgap.jumping.models.rigid_body import FEATURES, RigidBody, Situation
from leapgap.jumping.task import ContactSchedule
from tests.conftest import A1_BODY

NAMES = [name for name in FEATURES if name not in ("x_from_start", "z_from_start")]
GAINED = Nominal(A1_BODY, (0.5, 0.9, 0.3))


def single(windows: Windows, seeds: int = 1, hidden: tuple[int, ...] = (24,)):
    config = NetworksConfig(inputs=dict.fromkeys(NAMES, 0.5), hidden=list(hidden), seeds=seeds, output_gain=1.0)
    return initial_networks(windows, GAINED, config, np.random.default_rng(1))


def kernels(windows: Windows):
    return kernel.fit(windows, fit_gains(windows, A1_BODY), KernelConfig(inputs=dict.fromkeys(NAMES, 0.5)))


def published_networks(windows: Windows):
    recipe = PublishedRecipeConfig(hidden_h=[8, 9], hidden_G=[11, 7], orthogonal_gain=1.0)
    return initial_published_networks(windows.grid, Nominal(RigidBody(12, 0.17)), recipe, np.random.default_rng(2))


MAKERS = {
    "nominal": lambda w: NominalModel(GAINED),
    "single": single,
    "ensemble": lambda w: single(w, 3),
    "deep": lambda w: single(w, 2, (12, 10, 8)),
    "published": published_networks,
    "kernel": kernels,
    "blend": lambda w: ModelEnsemble((single(w, 3), kernels(w))),
}


@pytest.fixture(params=MAKERS)
def model(request, windows: Windows):
    return MAKERS[request.param](windows)


def written(model, windows: Windows, folder) -> inference.ExportedModel:
    store.export_model(store.StoredModel(model, Purpose.of(windows), windows.jumps, "k"), folder, "m")
    return inference.load(folder, "m", Purpose.of(windows))


def situations(windows: Windows) -> tuple[Situation, np.ndarray]:
    """All kinds of moments, in contact and flight mixed, some metres away from the origin."""
    k = 8
    state, start = windows.state[:, k].copy(), windows.state[:, 0].copy()
    state[:, 0] += 3.0
    start[:, 0] += 3.0
    return Situation(state, windows.foot[:, k], windows.time_s[:, k], start), windows.contact[:, k]


def assert_same(found, expected) -> None:
    for name in ("bias", "by_force"):
        a, b = getattr(found, name), getattr(expected, name)
        assert a.shape == b.shape
        np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-5 * np.abs(b).max(), err_msg=name)


def test_the_reader_equals_the_model(model, windows: Windows, tmp_path):
    reader, (situation, contact) = written(model, windows, tmp_path), situations(windows)
    assert contact.any() and not contact.all()
    whole = model.affine(situation, contact)
    assert_same(reader.affine(situation, contact), whole)
    one = Situation(*(array[:1] for array in vars(situation).values()))
    assert_same(reader.affine(one, contact[:1]), model.affine(one, contact[:1]))


@pytest.mark.parametrize("part", ["constant", "feet", "0/weight_0", "0/bias_1", "deviation"])
def test_arrays_that_are_turned_or_of_another_length_are_refused(part: str, windows: Windows, tmp_path):
    written(single(windows), windows, tmp_path)
    with np.load(tmp_path / "m.npz") as archive:
        arrays = {name: archive[name] for name in archive.files}
    name = part if part == "deviation" else f"flight/{part}"
    arrays[name] = np.zeros((3, 6, windows.grid.steps)) if part == "deviation" else arrays[name].T
    if arrays[name].ndim == 1:
        arrays[name] = arrays[name][:-1]
    np.savez(tmp_path / "m.npz", **arrays)
    with pytest.raises(InputError, match="a model that does not fit"):
        inference.load(tmp_path, "m", Purpose.of(windows))


def test_onnx_equals_the_model(model, windows: Windows, tmp_path):
    written(model, windows, tmp_path)
    session = onnxruntime.InferenceSession(tmp_path / "m.onnx", providers=["CPUExecutionProvider"])
    situation, contact = situations(windows)
    asked = {name: np.asarray(array, float) for name, array in vars(situation).items()} | {"contact": contact}
    bias, by_force = session.run(["bias", "by_force"], asked)
    assert_same(type(model.affine(situation, contact))(bias, by_force), model.affine(situation, contact))
    about = json.loads(session.get_modelmeta().custom_metadata_map["leapgap"])
    assert about["grid"] == {"contact_step_s": 0.025, "flight_step_s": 0.1, "steps": 10}
    assert about["robot_sha256"] == windows.robot_sha256 and about["schedule"]["flight_s"] == 0.4


@pytest.mark.parametrize("seeds", [1, 3])
def test_the_reader_equals_the_trained_network_in_torch(windows: Windows, tmp_path, seeds):
    import torch

    model = single(windows, seeds)
    twin = training.ResidualModule(model, dropout=0.0).eval()
    reader, (situation, contact) = written(model, windows, tmp_path), situations(windows)
    force = windows.force[:, 8]
    found = reader.affine(situation, contact).acceleration(force)
    for pushing in (True, False):
        mine = contact == pushing
        now, foot, time_s, start = (torch.tensor(a[mine], dtype=torch.float32) for a in vars(situation).values())
        asked = Situation(now.expand(seeds, -1, -1), foot, time_s, start.expand(seeds, -1, -1))
        torchs = twin(asked, torch.tensor(force[mine], dtype=torch.float32), pushing)[0].mean(dim=0).detach().numpy()
        np.testing.assert_allclose(found[mine], torchs, rtol=1e-5, atol=1e-5 * np.abs(torchs).max())


@pytest.mark.parametrize(
    "change, said",
    [
        ({"grid": TimeGrid(flight_step_s=0.08)}, r"m.json: found a model for grid .*0\.1.*expected grid .*0\.08"),
        ({"grid": TimeGrid(steps=22)}, "a model for grid"),
        ({"schedule": ContactSchedule(0.5, 0.3, 0.5)}, "a model for schedule"),
        ({"robot_sha256": "another"}, "a model for robot_sha256"),
    ],
)
def test_another_purpose_is_refused(windows: Windows, tmp_path, change, said):
    written(NominalModel(GAINED), windows, tmp_path)
    with pytest.raises(InputError, match=said):
        inference.load(tmp_path, "m", replace(Purpose.of(windows), **change))


def test_only_models_of_forces_are_exported(windows: Windows):
    with pytest.raises(InputError, match="export: found playback; expected a residual model"):
        Playback.fit(windows).flatten()


def test_the_same_model_gives_the_same_bytes(windows: Windows, tmp_path):
    for folder in ("a", "b"):
        written(single(windows, 3), windows, tmp_path / folder)
    for file in ("m.npz", "m.onnx", "m.json"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_reading_needs_neither_torch_nor_onnx():
    heavy = {"torch", "onnx", "onnxruntime"}
    code = f"import sys, leapgap.jumping.control.inference; sys.exit(bool({heavy} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0

"""Networks: their training with Lightning, and the pipeline that trains every model and keeps finished work."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from omegaconf import OmegaConf

from leapgap.errors import InputError
from leapgap.jumping.learning import (
    evaluation,
    model_grid,
    recipe,
    store,
    training,
    window_extraction,
)
from leapgap.jumping.learning.experiment import TrainConfig, folds
from leapgap.jumping.learning.model import Nominal, squared_errors
from leapgap.jumping.learning.models.kernel import KernelConfig
from leapgap.jumping.learning.models.nominal import ConstantVelocity, NominalModel, Playback, fit_gains
from leapgap.jumping.learning.models.residual_networks import NetworksConfig, PublishedRecipeConfig, initial_networks
from leapgap.jumping.learning.recipe import Fitting
from leapgap.jumping.learning.store import recipes
from leapgap.jumping.learning.windows import ARRAYS, TimeGrid, Windows
from leapgap.runtime.atomic_io import read_json
from stages.compose import compose_conf
from tests.conftest import A1_BODY

INPUTS = {"z": 1.0, "pitch": 1.0, "vx": 1.0, "vz": 1.0, "pitch_rate": 1.0, "front_foot_x": 1.0, "phase": 1.0}
QUIET = {"enable_progress_bar": False}
NETWORKS = NetworksConfig(inputs=INPUTS, hidden=[16], seeds=2, fitting=Fitting(steps=12, learning_rate=0.02))
KERNEL = KernelConfig(inputs=INPUTS)
SHORT = replace(NETWORKS, fitting=replace(NETWORKS.fitting, steps=3))


def config(**changes) -> TrainConfig:
    small = PublishedRecipeConfig(
        hidden_h=[8, 8],
        hidden_G=[9, 9],
        fitting=Fitting(steps=2, learning_rate=2e-4, cosine_decay=False, weight_decay=0.0, clip_norm=0.0, loss="sum"),
    )
    return replace(
        TrainConfig(
            windows="",
            sessions=None,
            mass_kg=A1_BODY.mass_kg,
            pitch_inertia_kgm2=A1_BODY.pitch_inertia_kgm2,
            curvature=0.0,  # as the jumps were made
            processes=1,
            models=sorted(recipes(), key=lambda name: len(recipes()[name].members)),  # means after what they are of
            folds=2,
            model_settings={"kernel": KERNEL, "networks": SHORT, "published_recipe": small},
            steps_an_epoch=4,
            threads=1,
            trainer=dict(QUIET),
        ),
        **changes,
    )


def fit(train: Windows, validation: Windows | None, scratch: Path, fitting: Fitting = NETWORKS.fitting, seed: int = 0):
    start = initial_networks(train, Nominal(A1_BODY), NETWORKS, np.random.default_rng(seed))
    return training.fit(start, train, validation, fitting, recipe.TrainingRun(seed, 1, QUIET, scratch, "test", 4))


def same(a, b) -> bool:
    return all(np.array_equal(x, y) for x, y in zip(a.arrays().values(), b.arrays().values(), strict=True))


def test_training_learns_repeats_bit_for_bit_and_notes_its_curve(windows: Windows, tmp_path):
    train, held_out = windows.of_jumps(windows.jumps[:4]), windows.of_jumps(windows.jumps[4:])
    steps = replace(NETWORKS.fitting, steps=60, dropout=0.1)
    first, curve = fit(train, held_out, tmp_path / "a", steps)
    again, _ = fit(train, held_out, tmp_path / "b", steps)
    assert same(first, again) and not (tmp_path / "a").exists()
    assert [row[0] for row in curve] == list(range(4, 61, 4)) and curve[-1][1] < 0.3 * curve[0][1]
    nominal = squared_errors(NominalModel(Nominal(A1_BODY)).predict(held_out.inputs), held_out).mean()
    assert squared_errors(first.predict(held_out.inputs), held_out).mean() < 0.3 * nominal


def test_a_killed_training_goes_on_to_the_same_bits(windows: Windows, tmp_path, monkeypatch):
    fitting = replace(NETWORKS.fitting, dropout=0.2)
    whole, curve = fit(windows, None, tmp_path / "whole", fitting)
    step = training.Learner.training_step

    def killed(self, *arguments):
        if self.trainer.global_step == 9:
            raise RuntimeError("killed")
        return step(self, *arguments)

    with monkeypatch.context() as patch:
        patch.setattr(training.Learner, "training_step", killed)
        with pytest.raises(RuntimeError, match="killed"):
            fit(windows, None, tmp_path / "cut", fitting)
    assert (tmp_path / "cut" / "last.ckpt").exists()
    resumed, resumed_curve = fit(windows, None, tmp_path / "cut", fitting)
    assert same(resumed, whole) and resumed_curve == curve


def corrupt_jump(windows: Windows, jump: str) -> Windows:
    mask = windows.jump == windows.jumps.index(jump)
    arrays = {n: getattr(windows, n).copy() for n in ("state", "force", "foot")}
    for array in arrays.values():
        array[mask] = array[mask] * 3 + 1
    return replace(windows, **arrays)


def test_nothing_of_a_held_out_jump_reaches_training(windows: Windows, tmp_path):
    """Its corruption leaves every weight, scale and gain of every model of its fold as it was, bit for bit."""
    small = config()
    model_grid.train(windows, small, tmp_path / "clean")
    model_grid.train(corrupt_jump(windows, "jump_02"), small, tmp_path / "corrupt")
    for name in recipes():
        clean, corrupt = (store.load(tmp_path / kind / "fold_0", name) for kind in ("clean", "corrupt"))
        assert "jump_02" not in clean.trained_on and same(clean.model, corrupt.model), name
        assert clean.model.settings() == corrupt.model.settings(), name
    changed = [store.load(tmp_path / kind / "fold_1", "networks").model for kind in ("clean", "corrupt")]
    assert not same(*changed)  # where it does train, it counts


def test_finished_models_are_kept_and_unknown_ones_removed(windows: Windows, tmp_path):
    small = config(models=["playback", "kernel", "networks"])
    assert len(model_grid.train(windows, small, tmp_path)) == 9
    before = {path: path.read_bytes() for path in sorted(tmp_path.rglob("*")) if path.is_file()}
    more = config(models=[*small.models, "nominal"], folds=3)
    model_grid.train(windows, more, tmp_path / "more")
    assert (tmp_path / "more" / "fold_2").exists() and (tmp_path / "more" / "fold_0" / "nominal.key").exists()
    (tmp_path / "more" / "fold_0" / "notes.txt").write_text("mine")
    model_grid.train(windows, small, tmp_path / "more")
    left = {path.relative_to(tmp_path / "more") for path in (tmp_path / "more").rglob("*") if path.is_file()}
    assert left == {path.relative_to(tmp_path) for path in before} | {Path("fold_0/notes.txt")}
    shutil.rmtree(tmp_path / "more")
    (tmp_path / "fold_0" / "kernel.npz").unlink()
    (tmp_path / "fold_1" / "playback.json").unlink()
    assert sorted(model_grid.train(windows, small, tmp_path)) == ["fold_0/kernel", "fold_1/playback"]
    assert {path: path.read_bytes() for path in sorted(tmp_path.rglob("*")) if path.is_file()} == before
    settings = {**small.model_settings, "kernel": replace(KERNEL, ridge_contact=0.5)}
    warmer = config(models=small.models, model_settings=settings)
    assert sorted(model_grid.train(windows, warmer, tmp_path)) == ["all/kernel", "fold_0/kernel", "fold_1/kernel"]


def test_metrics_predictions_and_refusals(windows: Windows, tmp_path):
    models = [name for name in recipes() if not name.startswith(("networks", "published", "blend"))]
    groups = [["jump_0[012]"], ["jump_0[345]"]]
    model_grid.train(windows, config(models=models, sessions=groups, not_in_sessions=["kernel"]), tmp_path / "models")
    quarters, halves = (
        evaluation.predict_held_out(windows, tmp_path / "models", prefix) for prefix in ("fold", "session")
    )
    assert quarters is not None and halves is not None
    found = evaluation.metrics(quarters, halves, windows)
    assert (found["jumps"], found["windows"]) == (6, 162)
    gained = NominalModel(fit_gains(windows, A1_BODY))  # the law of these jumps: held-out error of its fits is nil
    assert found["cv_mse"]["nominal_fitted"] < 1e-12 and found["cv_mse"]["nominal"] > 0.01
    assert set(found["forecast_cv_mse"]) == {"constant_velocity", "playback", "kernel"}
    assert set(found["forecast_cv_mse"]) == set(found["forecast_cv_mse_se"])
    assert "kernel" not in found["cv_mse_sessions"] and "kernel_forecast" not in found["cv_mse"]
    error = squared_errors(quarters.states["playback"], windows).mean(axis=(1, 2)).reshape(6, 27).mean(axis=1)
    assert found["cv_mse"]["playback"] == pytest.approx(error.mean(), rel=1e-5)
    assert found["cv_mse_se"]["playback"] == pytest.approx(error.std(ddof=1) / np.sqrt(6), rel=1e-5)

    evaluation.write_predictions(quarters, tmp_path)
    table = pq.read_table(tmp_path / "jump_04.parquet")
    assert table.column_names[:4] == ["model", "window", "step", "time"]
    assert table.num_rows == (len(models) + 1) * 27 * 11
    rows = [
        i
        for i, (m, w) in enumerate(zip(table["model"].to_pylist(), table["window"].to_pylist(), strict=True))
        if m == "measured" and w == 26
    ]
    assert table["time"].take(rows).to_pylist()[0] == pytest.approx(0.65)
    assert table["time"].take(rows).to_pylist()[-1] == pytest.approx(1.2)
    assert table["x"].take(rows).to_pylist()[0] == pytest.approx(windows.start_x[4 * 27 + 26])

    unseen = evaluation.errors_on_other_jumps(windows, tmp_path / "models")
    assert unseen["nominal_fitted"] == pytest.approx(
        squared_errors(gained.predict(windows.inputs), windows).mean(), abs=1e-12
    )
    for other, said in (
        (replace(windows, robot_sha256="other"), "a model for robot_sha256"),
        (replace(windows, grid=TimeGrid(flight_step_s=0.05)), "a model for grid"),
    ):
        with pytest.raises(InputError, match=said):
            evaluation.errors_on_other_jumps(other, tmp_path / "models")


@pytest.mark.long
def test_splits_side_by_side_give_the_same_bytes(windows: Windows, tmp_path):
    small = config(models=["playback", "kernel", "networks", "blend"])
    for name, processes in (("one", 1), ("two", 2)):
        model_grid.train(windows, replace(small, processes=processes), tmp_path / name)
    files = {
        name: {p.relative_to(tmp_path / name): p.read_bytes() for p in (tmp_path / name).rglob("*") if p.is_file()}
        for name in ("one", "two")
    }
    assert files["one"] == files["two"] and Path("exported/blend.onnx") in files["one"]


def test_no_windows_leave_a_note_and_no_models(windows: Windows, robot, tmp_path):
    model_grid.train(windows, config(models=["playback"]), tmp_path)
    assert model_grid.train(window_extraction.cut([], TimeGrid(), robot), config(), tmp_path) == []
    assert [path.name for path in tmp_path.iterdir()] == ["note.json"]
    assert "no logs" in read_json(tmp_path / "note.json")["note"]


def test_networks_beat_their_baselines_on_real_jumps(real_windows: Windows, tmp_path):
    """With the configured inputs, on one fold and in a third of the steps."""
    section = OmegaConf.create(compose_conf()).train.networks
    ours: NetworksConfig = OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(NetworksConfig), section))
    split = folds(real_windows.jumps, 4)[0]
    train, held_out = (real_windows.of_jumps(part) for part in (split.train, split.held_out))
    start = initial_networks(train, fit_gains(train, A1_BODY), ours, np.random.default_rng(0))
    run = recipe.TrainingRun(0, 1, QUIET, tmp_path / "scratch", "test", 25)
    networks, _ = training.fit(start, train, None, replace(ours.fitting, steps=50), run)
    found = {
        name: squared_errors(model.predict(held_out.inputs), held_out).mean()
        for name, model in {
            "networks": networks,
            "playback": Playback.fit(train),
            "still": ConstantVelocity(),
            "nominal": NominalModel(Nominal(A1_BODY)),
        }.items()
    }
    assert found["networks"] < 0.06 < found["playback"] < found["still"] < found["nominal"]


def test_an_unknown_model_is_named(windows: Windows, tmp_path):
    with pytest.raises(InputError, match=r"train.models: found oracle; expected some of blend, blend_no_phase"):
        model_grid.train(windows, config(models=["oracle"]), tmp_path)


def test_a_trainer_that_is_not_there_is_named(windows: Windows, tmp_path):
    with pytest.raises(InputError, match=r"train.trainer: found .*invalid accelerator name: `accelerator='abacus'`"):
        model_grid.train(windows, config(models=["networks"], trainer={"accelerator": "abacus"}), tmp_path)


def test_all_arrays_of_windows_are_listed(windows: Windows):
    """They are hashed into the keys and cut by jump; one forgotten would do neither."""
    assert set(ARRAYS) == {name for name, value in vars(windows).items() if isinstance(value, np.ndarray)}


def test_networks_of_more_windows_than_fit_into_memory_are_trained_on_some_of_them(
    windows: Windows, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen, setup = {}, training.Learner.setup

    def count(self: training.Learner, stage: str) -> None:
        seen.update({name: np.bincount(some.jump).tolist() for name, some in enumerate(self.windows)})
        setup(self, stage)

    monkeypatch.setattr(training, "MOST_WINDOWS", 54)
    monkeypatch.setattr(training.Learner, "setup", count)
    held_out = windows.of_jumps(windows.jumps[4:])
    _, curve = fit(windows, held_out, tmp_path / "a", replace(NETWORKS.fitting, steps=4))
    assert seen == {0: [9] * 6, 1: [27, 27]}
    assert len(curve) == 1 and np.isfinite(curve[0]).all()

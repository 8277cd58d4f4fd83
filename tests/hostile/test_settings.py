"""Settings that mean nothing are refused before any work, with their full key."""

import json
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from leapgap.diagnosis.joint_fit import JointFitSettings
from leapgap.diagnosis.settings import Settings
from leapgap.errors import InputError
from leapgap.jumping.control.mpc import MpcConfig
from leapgap.jumping.experiments.method import JumpTask
from leapgap.jumping.export.write import ExportSettings
from leapgap.jumping.learning.recipe import Fitting
from leapgap.jumping.models.rigid_body import RigidBody
from leapgap.settings import from_json
from leapgap.simulation.closed_loop import Sensing
from stages.common import params_with_overrides, read_config
from stages.compose import compose_conf

NAN = float("nan")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("folds", 0), ("folds", 1), ("folds", -3), ("pieces_per_log", 0), ("most_pieces", 0), ("noise_draws", 0)),
        *(("bootstrap_draws", 0), ("seed", -1), ("horizon_s", 0.0), ("horizon_s", NAN), ("every_s", -0.01)),
        *(("every_s", float("inf")), ("every_s", 0.2), ("where_horizon_s", 0.0), ("model_error", -1.0)),
        *(("clock_threshold", NAN), ("planted_threshold_m", -1.0)),
    ],
)
def test_a_diagnosis_refuses_its_settings_by_name(name: str, value: float) -> None:
    with pytest.raises(InputError, match=f"^settings.{name}: found {value}; expected "):
        Settings(**{name: value})


@pytest.mark.parametrize("name", ["first_steps", "all_steps", "steps", "most_causes"])
def test_a_joint_fit_without_steps_is_refused(name: str) -> None:
    with pytest.raises(InputError, match=f"^settings.joint.{name}: found 0; expected 1 or more"):
        JointFitSettings(**{name: 0})


@pytest.mark.parametrize("size", [0.0, -1.0, NAN, float("inf")])
def test_sizes_and_tolerances_are_numbers_above_zero(size: float) -> None:
    with pytest.raises(InputError, match=r"settings.sizes.joint_pos"):
        Settings(sizes={"joint_pos": size})
    with pytest.raises(InputError, match=r"settings.tolerances.payload.mass_kg"):
        Settings(tolerances={"payload.mass_kg": size})


@pytest.mark.parametrize(
    ("kind", "section", "where"),
    [
        (Sensing, {"base_delay_s": NAN}, "collect.sensing.base_delay_s"),
        (Sensing, {"noise": {"base_pos_m": NAN}}, "collect.sensing.noise.base_pos_m"),
        (MpcConfig, {"period_s": NAN}, "collect.sensing.period_s"),
        (JumpTask, {"name": "x", "x_m": 0.5, "block_m": [0.0, NAN]}, r"collect.sensing.block_m\[1\]"),
    ],
)
def test_nan_is_refused_in_every_section_of_the_configuration(kind: type, section: dict, where: str) -> None:
    with pytest.raises(InputError, match=f"^{where}: found nan; expected a number"):
        read_config(kind, OmegaConf.create(section), "collect.sensing")


def test_nan_is_refused_in_a_file_of_settings(tmp_path: Path) -> None:
    path = tmp_path / "settings.json"
    path.write_text(json.dumps({"horizon_s": NAN}))
    with pytest.raises(InputError, match=r"settings.json, horizon_s: found nan"):
        from_json(Settings, path)


@pytest.mark.parametrize(
    ("kind", "section"),
    [
        (RigidBody, {"mass_kg": 0.0, "pitch_inertia_kgm2": 0.3}),
        (RigidBody, {"mass_kg": 12.0, "pitch_inertia_kgm2": -0.3}),
        (JumpTask, {"name": "x", "x_m": 0.5, "jumps": 0}),
        (MpcConfig, {"period_s": 0.0}),
        (Fitting, {"steps": 0}),
    ],
)
def test_numbers_without_a_meaning_are_refused_where_they_are_read(kind: type, section: dict) -> None:
    with pytest.raises(InputError, match=r"^section: found "):
        read_config(kind, OmegaConf.create(section), "section")


def test_the_configuration_itself_is_taken() -> None:
    section = OmegaConf.create(compose_conf()).diagnose.settings
    assert read_config(Settings, section, "diagnose.settings") == Settings()


@pytest.mark.parametrize("target", [[0.5], [], [0.5, 0.0, 0.0], [float("inf"), 0.0], [NAN, 0.0], [1e300, 0.0]])
def test_an_export_without_a_jump_is_refused_before_the_robot_practises(target: list[float]) -> None:
    section = OmegaConf.create(compose_conf()).export
    section.target = target
    with pytest.raises(InputError, match=r"^(export|jump target: found x 1e\+300 m)"):
        read_config(ExportSettings, section, "export")
    section.target, section.stance_pitch_rad = [0.5, 0.0], 2.0
    with pytest.raises(InputError, match=r"stance_pitch_rad 2.0: less than a quarter turn"):
        read_config(ExportSettings, section, "export")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"a: 1\na: 2\n", "no valid YAML \\(.*duplicate key a"),
        (b"a: [1\n", "no valid YAML"),
        (b"\xff\xfe", "no valid YAML"),
        (None, "no such file"),
        (b"[1]", "no sections"),
        (b"{}", "no sections"),
        (b"a: " + b"[" * 3000 + b"]" * 3000, "no valid YAML"),
    ],
)
def test_a_broken_file_of_parameters_is_one_message(
    content: bytes | None, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if content is not None:
        (tmp_path / "params.yaml").write_bytes(content)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=f"^params.yaml: found {says}"):
        params_with_overrides(["chunk.out=x"])

"""A truth that was changed after it was sealed is refused."""

import json
from pathlib import Path

import pytest

from leapgap.errors import InputError
from leapgap.runtime.atomic_io import sha256, write_json
from leapgap.validation.seal import SEALS, open_truth, seal


@pytest.fixture
def sealed_folder(tmp_path: Path) -> Path:
    for folder in ("logs/case_000", "truth/case_000"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "jump_0.parquet").write_bytes(b"jump")
    digest = {"jump_0.parquet": sha256(tmp_path / "logs/case_000/jump_0.parquet")}
    truth = {
        "salt": "ab12",
        "effects": [{"name": "payload", "parameters": {"mass_kg": 1.0}}],
        "logs": digest,
        "proof": digest,
    }
    write_json(tmp_path / "truth/case_000.json", truth)
    write_json(tmp_path / "logs" / SEALS, {"case_000": seal(truth)})
    return tmp_path


def test_an_untouched_truth_opens(sealed_folder: Path) -> None:
    assert open_truth(sealed_folder / "truth", sealed_folder / "logs", "case_000")["effects"][0]["name"] == "payload"


def test_a_changed_truth_is_refused(sealed_folder: Path) -> None:
    path = sealed_folder / "truth/case_000.json"
    path.write_text(path.read_text().replace("1.0", "1.5"))
    with pytest.raises(InputError, match="changed after it was sealed"):
        open_truth(sealed_folder / "truth", sealed_folder / "logs", "case_000")


@pytest.mark.parametrize("side", ["logs", "truth"])
def test_a_changed_jump_is_refused(sealed_folder: Path, side: str) -> None:
    (sealed_folder / side / "case_000" / "jump_0.parquet").write_bytes(b"another")
    with pytest.raises(InputError, match=r"jump_0\.parquet"):
        open_truth(sealed_folder / "truth", sealed_folder / "logs", "case_000")


def test_a_changed_model_of_a_cases_own_robot_is_refused(sealed_folder: Path) -> None:
    model = sealed_folder / "logs/case_000/robot.xml"
    model.write_text("<mujoco/>")
    truth = json.loads((sealed_folder / "truth/case_000.json").read_text()) | {"model": {"robot.xml": sha256(model)}}
    write_json(sealed_folder / "truth/case_000.json", truth)
    write_json(sealed_folder / "logs" / SEALS, {"case_000": seal(truth)})
    assert open_truth(sealed_folder / "truth", sealed_folder / "logs", "case_000")["model"]
    model.write_text("<mujoco model='another'/>")
    with pytest.raises(InputError, match=r"robot\.xml"):
        open_truth(sealed_folder / "truth", sealed_folder / "logs", "case_000")


def test_a_seal_needs_its_salt_and_depends_on_it() -> None:
    with pytest.raises(InputError, match="no salt"):
        seal({"effects": []})
    assert seal({"salt": "a", "effects": []}) != seal({"salt": "b", "effects": []})
    text = {"salt": "a", "b": 1, "a": 2}
    assert seal(text) == seal(json.loads(json.dumps(dict(reversed(text.items())))))

"""Windows and models that are broken, or that become so, are refused: no NaN is stored, loaded or trained on."""

import json
import re
import zipfile
from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from leapgap.errors import InputError
from leapgap.jumping.learning import model_grid, store, window_extraction, windows
from leapgap.jumping.learning.model import Nominal
from leapgap.jumping.learning.models.kernel import KernelConfig
from leapgap.jumping.learning.models.kernel import fit as fit_kernel
from leapgap.jumping.learning.models.nominal import NominalModel
from leapgap.jumping.learning.models.residual_networks import NetworksConfig
from leapgap.jumping.learning.recipe import Fitting
from leapgap.jumping.learning.store import StoredModel
from leapgap.jumping.learning.windows import Purpose, TimeGrid, Windows
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from tests.conftest import A1_BODY
from tests.jumping.learning.conftest import jumps  # noqa: F401 - fixture
from tests.jumping.learning.test_training import config

Arrays = dict[str, np.ndarray]


@pytest.fixture
def cut_windows(jumps: list[Log], robot: Robot) -> Windows:  # noqa: F811
    return window_extraction.cut(jumps, TimeGrid(), robot)


@pytest.fixture
def folder(cut_windows: Windows, tmp_path: Path) -> Path:
    windows.write(cut_windows, tmp_path / "windows")
    return tmp_path / "windows"


def change(folder: Path, harm: Callable[[Arrays], None]) -> None:
    """Change the stored arrays of some windows."""
    with np.load(folder / "windows.npz") as archive:
        arrays = {name: archive[name] for name in archive.files}
    harm(arrays)
    np.savez(folder / "windows.npz", **arrays)


def put(name: str, index: tuple, value: float) -> Callable[[Arrays], None]:
    """Set one entry of one array."""

    def harm(arrays: Arrays) -> None:
        arrays[name][index] = value

    return harm


HARMS: dict[str, tuple[Callable[[Arrays], None], str]] = {
    "nan state": (put("state", (3, 2, 1), np.nan), "1 of 10692 values of state that are not finite"),
    "infinite force": (put("force", (0, 0, 0), np.inf), "1 of 6480 values of force that are not finite"),
    "short": (lambda a: a.update(force=a["force"][:-1]), "force has shape (161, 10, 4) and kind f, not shape (162"),
    "few steps": (lambda a: a.update(foot=a["foot"][:, :4]), "foot has shape (162, 4, 4)"),
    "texts": (lambda a: a.update(start_x=a["start_x"].astype(str)), "values of type <U"),
    "fractions": (lambda a: a.update(start=a["start"] + 0.5), "start has shape (162,) and kind f"),
    "pickle": (lambda a: a.update(start_x=np.array([{}] * 162, object)), "values of type object"),
    "no such jump": (put("jump", (0,), 77), "6 jumps, of which 7 have"),
    "negative jump": (put("jump", (0,), -1), "6 jumps, of which 7 have"),
    "uneven": (lambda a: a.update({n: v[:-1] for n, v in a.items()}), "6 jumps, of which 6 have [26, 27] windows"),
    "backwards": (put("time_s", (0, 5), -1.0), "steps that end before they begin"),
    "one is missing": (lambda a: a.pop("foot") is None, "windows that do not fit"),
    "one too many": (lambda a: a.update(more=np.zeros(3)), "windows that do not fit"),
}


@pytest.mark.parametrize("name", HARMS)
def test_broken_windows_are_refused_with_what_is_broken(name: str, folder: Path) -> None:
    harm, says = HARMS[name]
    change(folder, harm)
    with pytest.raises(InputError) as refusal:
        windows.read(folder)
    assert says in str(refusal.value) and str(folder) in str(refusal.value)


ABOUT = {
    "no steps": {"grid": {"contact_step_s": 0.025, "flight_step_s": 0.1, "steps": 0}},
    "NaN step": {"grid": {"contact_step_s": float("nan"), "flight_step_s": 0.1, "steps": 10}},
    "text for a step": {"grid": {"contact_step_s": "0.025", "flight_step_s": 0.1, "steps": 10}},
    "list for a grid": {"grid": [1]},
    "no schedule": {"schedule": None},
    "text for a schedule": {"schedule": "now"},
    "one jump twice": {"jumps": ["a"] * 6},
    "number for jumps": {"jumps": 6},
    "numbers for names": {"jumps": [1, 2, 3, 4, 5, 6]},
}


@pytest.mark.parametrize("name", ABOUT)
def test_windows_with_a_broken_description_are_refused(name: str, folder: Path) -> None:
    path = folder / "windows.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **ABOUT[name]}))
    with pytest.raises(InputError):
        windows.read(folder)


def claims(shape: str) -> bytes:
    """An archive whose array claims a shape that it has not."""
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    archive = BytesIO()
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("state.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + b"12")
    return archive.getvalue()


def bomb() -> bytes:
    """An archive of 5 MB whose array has 5 GiB."""
    archive = BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file, file.open("state.npy", "w") as member:
        for _ in range(5):
            member.write(bytes(1 << 20))
    data = bytearray(archive.getvalue())
    at = data.rindex(b"PK\x01\x02") + 24  # the size in the directory of the archive
    data[at : at + 4] = (0xFFFFFFF0).to_bytes(4, "little")
    return bytes(data)


@pytest.mark.parametrize(
    "content",
    [b"", b"PK", b"\x93NUMPY", b"nonsense" * 99, claims("(10000000000000,)"), claims("(-1,)"), claims("'x'"), bomb()],
    ids=["empty", "magic", "single array", "text", "huge", "negative", "no shape", "too large"],
)
def test_files_that_are_no_archive_are_refused_before_memory_is_taken(content: bytes, folder: Path) -> None:
    (folder / "windows.npz").write_bytes(content)
    with pytest.raises(InputError, match="no whole archive"):
        windows.read(folder)


def test_an_archive_that_is_cut_short_is_refused(folder: Path) -> None:
    path = folder / "windows.npz"
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(InputError, match="no whole archive"):
        windows.read(folder)


def test_an_empty_description_is_refused(folder: Path) -> None:
    (folder / "windows.json").write_bytes(b"")
    with pytest.raises(InputError, match="no valid JSON"):
        windows.read(folder)


def test_a_description_that_nests_without_end_is_refused(folder: Path) -> None:
    (folder / "windows.json").write_text("[" * 100_000)
    with pytest.raises(InputError, match="no valid JSON"):
        windows.read(folder)


def test_a_folder_in_place_of_a_file_is_refused(folder: Path) -> None:
    (folder / "windows.npz").unlink()
    (folder / "windows.npz").mkdir()
    with pytest.raises(InputError, match="found no plain file"):
        windows.read(folder)


def test_windows_with_nan_are_not_written(cut_windows: Windows, tmp_path: Path) -> None:
    state = cut_windows.state.copy()
    state[0, 0, 0] = np.nan
    with pytest.raises(InputError, match="1 of 10692 values of state that are not finite"):
        windows.write(replace(cut_windows, state=state), tmp_path / "out")
    assert not list((tmp_path / "out").glob("*.npz"))


@pytest.mark.parametrize("step", [float("nan"), float("inf"), 0.0])
def test_a_time_grid_without_lengths_is_refused(step: float) -> None:
    with pytest.raises(InputError):
        TimeGrid(contact_step_s=step)


def kernel(cut: Windows) -> StoredModel:
    """A kernel fitted to some windows."""
    model = fit_kernel(cut, Nominal(A1_BODY), KernelConfig(inputs={"z": 1.0, "phase": 1.0}))
    return StoredModel(model, Purpose.of(cut), cut.jumps, "key")


def test_nan_weights_are_not_stored(cut_windows: Windows, tmp_path: Path) -> None:
    stored = kernel(cut_windows)
    assert stored.model.contact is not None
    part = replace(stored.model.contact, weights=stored.model.contact.weights * np.nan)
    with pytest.raises(InputError, match="values of contact/weights that are not finite"):
        store.save(replace(stored, model=replace(stored.model, contact=part)), tmp_path, "kernel")
    assert not list(tmp_path.iterdir())


def test_a_gain_of_nan_is_not_stored(cut_windows: Windows, tmp_path: Path) -> None:
    model = NominalModel(Nominal(A1_BODY, (1.0, np.nan, 1.0)))
    with pytest.raises(InputError, match="model nominal: found a setting that is not finite"):
        store.save(StoredModel(model, Purpose.of(cut_windows), cut_windows.jumps, "key"), tmp_path, "nominal")


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_nan_weights_are_not_loaded(value: float, cut_windows: Windows, tmp_path: Path) -> None:
    store.save(kernel(cut_windows), tmp_path, "kernel")
    with np.load(tmp_path / "kernel.npz") as archive:
        arrays = {name: archive[name].copy() for name in archive.files}
    arrays["flight/weights"][0, 0] = value
    np.savez(tmp_path / "kernel.npz", **arrays)
    with pytest.raises(InputError, match="values of flight/weights that are not finite"):
        store.load(tmp_path, "kernel")


def test_a_model_whose_arrays_do_not_fit_together_is_not_loaded(cut_windows: Windows, tmp_path: Path) -> None:
    store.save(kernel(cut_windows), tmp_path, "kernel")
    with np.load(tmp_path / "kernel.npz") as archive:
        arrays = {name: archive[name] for name in archive.files}
    arrays["contact/weights"] = arrays["contact/weights"][:-1]
    np.savez(tmp_path / "kernel.npz", **arrays)
    with pytest.raises(InputError, match="a model that does not fit"):
        store.load(tmp_path, "kernel")


@pytest.mark.long
@pytest.mark.parametrize("processes", [1, 2])
def test_a_training_that_diverges_is_a_message(processes: int, cut_windows: Windows, tmp_path: Path) -> None:
    """From worker processes, too; what was fitted before stays, and no half model is left."""
    wild = NetworksConfig(hidden=[8], seeds=1, fitting=Fitting(steps=40, learning_rate=1e6, clip_norm=0.0))
    departed = config(models=["nominal", "networks"], processes=processes, model_settings={"networks": wild})
    with pytest.raises(InputError) as refusal:
        model_grid.train(cut_windows, departed, tmp_path / "models")
    own = "fold_0" if processes == 1 else r"fold_\d"  # several workers: whichever comes first
    assert re.match(rf"training of {own} networks: found a loss of ", str(refusal.value))
    assert "lower fitting.learning_rate of this model" in str(refusal.value)
    assert [path.name for path in (tmp_path / "models" / "fold_0").glob("*.npz")] == ["nominal.npz"]


@pytest.mark.parametrize(
    "wrong",
    [{"steps": 0}, {"learning_rate": float("nan")}, {"dropout": 1.0}, {"clip_norm": -1.0}, {"weight_decay": np.inf}],
)
def test_settings_of_a_training_that_mean_nothing_are_refused(wrong: dict) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Fitting(**wrong)


def test_windows_of_one_jump_are_trained_on_and_none_are_said(cut_windows: Windows, tmp_path: Path) -> None:
    """The smallest inputs: one jump, and no jump."""
    one = cut_windows.of_jumps(cut_windows.jumps[:1])
    assert model_grid.train(one, config(models=["kernel"]), tmp_path / "one") == ["all/kernel"]
    assert model_grid.train(cut_windows.of_jumps([]), config(models=["kernel"]), tmp_path / "none") == []

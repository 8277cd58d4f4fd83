"""Each format against a file that its own library wrote, and against files that are damaged or mean harm."""

import io
import json
import pickle
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io

from leapgap.errors import InputError
from leapgap.logs.importers import log_format
from leapgap.logs.importers.tables import Table
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from tests.logs.test_tables import NO_COMMANDS

ROWS = 40
TIME = 5 + 0.01 * np.arange(ROWS)
Q = np.stack([0.1 * TIME, -0.3 * TIME], axis=1)
ORDER = ["elbow", "shoulder"]


def read(name: str, path: Path, arm: Robot, time: str, position: str, **options: object) -> Log:
    """The log in a file whose joints are numbered elbow, shoulder."""
    layout = log_format(name)
    columns = {"time": time, "joint_pos/*": position}
    chosen = layout.Options(columns=columns, joint_order=ORDER, constants=NO_COMMANDS, **options)
    return layout.read(path, path.stem, arm, chosen)


def assert_right(log: Log) -> None:
    assert log.time == pytest.approx(TIME - 5, abs=1e-9)
    assert log["joint_pos/elbow"] == pytest.approx(Q[:, 0], rel=1e-6)
    assert log["joint_pos/shoulder"] == pytest.approx(Q[:, 1], rel=1e-6)


def test_npz(arm: Robot, tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "a.npz", t=TIME, q=Q, note=np.array("by hand"))
    assert_right(read("npz", tmp_path / "a.npz", arm, "t", "q[*]"))
    np.savez(tmp_path / "b.npz", t=TIME[:, None], q=Q.T)  # a column as a matrix, and rows across
    assert_right(read("npz", tmp_path / "b.npz", arm, "t", "q[*]"))
    with pytest.raises(
        InputError, match=r"a\.npz: found no column v\[1\]; expected the column that is to be joint_pos/sh"
    ):
        read("npz", tmp_path / "a.npz", arm, "t", "v[*]")
    with pytest.raises(InputError, match=r"a\.npz, q: found shape \(40, 2\); expected a column \[2\]"):
        log_format("npz").read(
            tmp_path / "a.npz", "a", arm, log_format("npz").Options(columns={"time": "t", "joint_pos/elbow": "q[2]"})
        )


def test_npy_with_fields(arm: Robot, tmp_path: Path) -> None:
    table = np.zeros(ROWS, dtype=[("t", "f8"), ("q", "f4", (2,))])
    table["t"], table["q"] = TIME, Q
    np.save(tmp_path / "a.npy", table)
    assert_right(read("npz", tmp_path / "a.npy", arm, "array.t", "array.q[*]"))


class Harm:
    """An object whose unpickling writes a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[..., object], tuple[object, ...]]:
        return Path.touch, (self.path,)


def test_npz_with_objects_is_refused_and_nothing_in_it_runs(arm: Robot, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", t=np.array([Harm(tmp_path / "hit")] * ROWS, dtype=object), q=Q)
    with pytest.raises(InputError, match=r"a\.npz, t: found Python objects; expected an array of numbers"):
        read("npz", tmp_path / "a.npz", arm, "t", "q[*]")
    assert not (tmp_path / "hit").exists()


def test_npz_that_states_more_than_fits_is_refused_by_its_header(arm: Robot, tmp_path: Path) -> None:
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)})
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as folder:
        folder.writestr("t.npy", head.getvalue())
    with pytest.raises(InputError, match=r"t: found 1e\+12 values; expected at most 5e\+08"):
        read("npz", tmp_path / "a.npz", arm, "t", "q[*]")


def test_parquet_with_lists_and_structures(arm: Robot, tmp_path: Path) -> None:
    whole = pa.table(
        {
            "stamp": pa.array((TIME * 1e9).round().astype(np.int64)),
            "state": pa.array([{"q": row.tolist(), "on": True} for row in Q]),
            "flat": pa.FixedSizeListArray.from_arrays(pa.array(Q.ravel()), 2),
            "picture.raw": pa.array(["x"] * ROWS),
        }
    )
    pq.write_table(whole, tmp_path / "a.parquet", row_group_size=7)
    for name in ("state.q[*]", "flat[*]"):
        log = read("parquet", tmp_path / "a.parquet", arm, "stamp", name, units={"time": "ns"})
        assert_right(log)
    ragged = whole.set_column(2, "flat", pa.array([[1.0, 2.0]] * 30 + [[1.0]] * 10))
    pq.write_table(ragged, tmp_path / "b.parquet")
    with pytest.raises(InputError, match="column flat, row 30: found 1 items; expected 2, as in row 0"):
        read("parquet", tmp_path / "b.parquet", arm, "stamp", "flat[*]")
    with pytest.raises(InputError, match=r"found 40 rows; expected at most 30 \(most_rows\)"):
        read("parquet", tmp_path / "a.parquet", arm, "stamp", "flat[*]", most_rows=30)


def test_hdf5(arm: Robot, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["observations/qpos"] = Q.astype(np.float32)
        file["t"] = TIME
        file.create_dataset("camera", shape=(10**6, 500, 500), dtype="u1", chunks=True)  # 250 GB, never written
        file["table"] = np.array(list(zip(TIME, Q[:, 0], strict=True)), dtype=[("t", "f8"), ("a", "f4")])
    assert_right(read("hdf5", tmp_path / "a.h5", arm, "t", "observations/qpos[*]"))
    assert_right(read("hdf5", tmp_path / "a.h5", arm, "table.t", "observations/qpos[*]"))
    with pytest.raises(InputError, match=r"camera: found 3\.12e\+10 values; expected at most 5e\+08"):
        read("hdf5", tmp_path / "a.h5", arm, "t", "camera[0,*]")


def test_hdf5_whose_data_lie_elsewhere_is_refused(arm: Robot, tmp_path: Path) -> None:
    (tmp_path / "secret").write_bytes(b"x" * 8 * ROWS)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("t", (ROWS,), "f8", external=[(str(tmp_path / "secret"), 0, 8 * ROWS)])
        file["q"] = Q
    with pytest.raises(InputError, match="t: found data in another file"):
        read("hdf5", tmp_path / "a.h5", arm, "t", "q[*]")


@pytest.mark.parametrize("compressed", [False, True])
def test_mat_of_version_5(arm: Robot, tmp_path: Path, compressed: bool) -> None:
    inner = {"q": Q, "name": "arm"}
    scipy.io.savemat(tmp_path / "a.mat", {"t": TIME[None, :], "log": inner}, do_compression=compressed)
    assert_right(read("mat", tmp_path / "a.mat", arm, "t", "log.q[*]"))


def test_mat_of_version_7_3_is_hdf5_with_rows_across(arm: Robot, tmp_path: Path) -> None:
    """MATLAB writes a header of 512 bytes before the HDF5, and its matrices column by column."""
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        file["t"], file["log/q"] = TIME[:, None].T, Q.T
    with (tmp_path / "a.mat").open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    assert_right(read("mat", tmp_path / "a.mat", arm, "t", "log.q[*]"))


def test_mat_that_unpacks_to_more_than_fits_is_refused_before(
    arm: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scipy.io.savemat(tmp_path / "a.mat", {"t": np.zeros(10**6), "q": Q}, do_compression=True)
    assert (tmp_path / "a.mat").stat().st_size < 20_000
    monkeypatch.setattr("leapgap.logs.importers.tables.MOST_BYTES", 4_000_000)
    monkeypatch.setattr("scipy.io.loadmat", lambda *_, **__: pytest.fail("it was read"))
    with pytest.raises(InputError, match=r"a\.mat: found 1e\+06 values; expected at most 5e\+05"):
        read("mat", tmp_path / "a.mat", arm, "t", "q[*]")


def test_pt_without_torch(arm: Robot, tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")
    saved = {
        "time": torch.tensor(TIME),
        "dof_pos": torch.tensor(Q.T, dtype=torch.float32).T,  # columns first in memory
        "more": {"half": torch.tensor(Q[::2], dtype=torch.float16), "counts": [torch.arange(6).reshape(2, 3)[:, 1:]]},
        "note": "hung up",
    }
    torch.save(saved, tmp_path / "a.pt")
    assert_right(read("pt", tmp_path / "a.pt", arm, "time", "dof_pos[*]"))
    arrays = log_format("pt").read_table(tmp_path / "a.pt", None, lambda _: True)
    assert arrays["more.counts.0"].tolist() == [[1, 2], [4, 5]]
    assert arrays["more.half"] == pytest.approx(Q[::2], rel=1e-3)


def write_pt(path: Path, pickled: bytes, **files: bytes) -> Path:
    with zipfile.ZipFile(path, "w") as folder:
        folder.writestr("a/data.pkl", pickled)
        for name, content in files.items():
            folder.writestr(f"a/data/{name[1:]}", content)
    return path


def tensor_pickle(values: int, shape: tuple[int, ...], strides: tuple[int, ...], offset: int = 0) -> bytes:
    """The pickle of one tensor under the name t, written by hand with the opcodes that torch.save uses."""

    def number(value: int) -> bytes:
        return b"\x8a\x08" + struct.pack("<q", value)

    def numbers(items: tuple[int, ...]) -> bytes:
        return b"(" + b"".join(map(number, items)) + b"t"

    text = lambda word: b"X" + struct.pack("<I", len(word)) + word  # noqa: E731
    storage = b"(" + text(b"storage") + b"ctorch\nFloatStorage\n" + text(b"0") + text(b"cpu") + number(values) + b"tQ"
    arguments = (
        b"(" + storage + number(offset) + numbers(shape) + numbers(strides) + b"\x89ccollections\nOrderedDict\n)Rt"
    )
    return b"\x80\x02}" + text(b"t") + b"ctorch._utils\n_rebuild_tensor_v2\n" + arguments + b"Rs."


def test_pt_by_hand_is_read(tmp_path: Path) -> None:
    content = np.arange(6, dtype="<f4").tobytes()
    path = write_pt(tmp_path / "a.pt", tensor_pickle(6, (2, 2), (3, 1), 1), _0=content)
    assert log_format("pt").read_table(path, None, lambda _: True)["t"].tolist() == [[1, 2], [4, 5]]


@pytest.mark.parametrize(
    ("pickled", "content", "message"),
    [
        (b"cos\nsystem\n(X\x04\x00\x00\x00trueTR.", b"", "found os.system in the pickle; expected tensors"),
        (b"cbuiltins\neval\n(X\x01\x00\x00\x001tR.", b"", "found builtins.eval in the pickle; expected tensors"),
        (tensor_pickle(6, (7,), (1,)), bytes(24), "a tensor that ends at value 6 of 6"),
        (tensor_pickle(6, (2,), (-1,)), bytes(24), "found no readable zip of tensors"),
        (tensor_pickle(6, (2,), (1,), -3), bytes(24), "found no readable zip of tensors"),
        (tensor_pickle(6, (10**6, 10**6), (0, 0)), bytes(24), r"found 1e\+12 values; expected at most"),
        (tensor_pickle(10**12, (6,), (1,)), bytes(24), "found 24 bytes; expected 1000000000000 values of 4 bytes"),
        (tensor_pickle(6, (6,), (1,))[:-9], bytes(24), "found no readable zip of tensors"),
        (
            b"ctorch._utils\n_rebuild_tensor_v2\nN}X\x08\x00\x00\x00functionNs\x86b.",
            b"",
            "found no readable zip of tensors",
        ),
    ],
)
def test_pt_that_means_harm_is_refused(tmp_path: Path, pickled: bytes, content: bytes, message: str) -> None:
    path = write_pt(tmp_path / "a.pt", pickled, _0=content)
    layout = log_format("pt")
    with pytest.raises(InputError, match=message):
        layout.table(path, layout.Options())


def test_pt_of_an_object_runs_nothing(tmp_path: Path) -> None:
    path = write_pt(tmp_path / "a.pt", pickle.dumps({"t": Harm(tmp_path / "hit")}))
    with pytest.raises(InputError, match="in the pickle; expected tensors in mappings and lists alone"):
        log_format("pt").read_table(path, None, lambda _: True)
    assert not (tmp_path / "hit").exists()


def write_lerobot(folder: Path, version: str = "v3.0") -> Path:
    """Two episodes in two files, as version 3 lays them out."""
    (folder / "meta").mkdir(parents=True)
    (folder / "data" / "chunk-000").mkdir(parents=True)
    names = {"motors": ["elbow.pos", "shoulder.pos"]}
    features = {"observation.state": {"dtype": "float32", "shape": [2], "names": names}, "action": {"names": None}}
    (folder / "meta" / "info.json").write_text(json.dumps({"codebase_version": version, "features": features}))
    for episode in range(2):
        table = pa.table(
            {
                "observation.state": pa.FixedSizeListArray.from_arrays(
                    pa.array((Q + episode).astype(np.float32).ravel()), 2
                ),
                "action": pa.array((Q - 1).tolist()),
                "timestamp": pa.array((TIME - 5).astype(np.float32)),
                "episode_index": pa.array(np.full(ROWS, episode)),
            }
        )
        pq.write_table(table, folder / "data" / "chunk-000" / f"file-00{episode}.parquet")
    return folder


def test_lerobot_episodes_are_logs(arm: Robot, tmp_path: Path) -> None:
    dataset = write_lerobot(tmp_path / "arm_data")
    layout = log_format("lerobot")
    constants = {key: value for key, value in NO_COMMANDS.items() if key != "cmd_pos/*"}
    columns = {"joint_pos/*": "observation.state.*.pos", "cmd_pos/elbow": "action[0]", "cmd_pos/shoulder": "action[1]"}
    options = layout.Options(columns=columns, constants=constants)
    for source in (dataset, tmp_path):
        assert layout.find(source) == {"arm_data": dataset}
    logs = layout.read_all(dataset, "arm_data", arm, options)
    assert [(log.name, len(log)) for log in logs] == [("arm_data_1", ROWS), ("arm_data_2", ROWS)]
    assert logs[1]["joint_pos/shoulder"] == pytest.approx(Q[:, 1] + 1, rel=1e-6)
    assert logs[0]["cmd_pos/elbow"] == pytest.approx(Q[:, 0] - 1)
    assert logs[1].time == pytest.approx(TIME - 5, abs=1e-6)
    assert len(layout.read_all(write_lerobot(tmp_path / "two", "v2.1"), "two", arm, options)) == 2
    old = write_lerobot(tmp_path / "old", "v1.6")
    with pytest.raises(InputError, match=r"found version v1\.6; expected version 2 or 3 of the format"):
        layout.read_all(old, "old", arm, options)


@pytest.mark.parametrize(
    ("name", "file", "message"),
    [
        ("npz", "a.npz", "found no readable NumPy archive"),
        ("parquet", "a.parquet", "found no readable Parquet"),
        ("hdf5", "a.h5", "found no readable HDF5"),
        ("mat", "a.mat", "found no readable MATLAB file"),
        ("pt", "a.pt", "found no readable zip of tensors"),
        ("ros", "a.bag", "found no readable recording"),
        ("ros", "a.mcap", "found no readable recording"),
        ("ros", "a.db3", "found no readable recording"),
    ],
)
def test_a_file_of_noise_is_refused(arm: Robot, tmp_path: Path, name: str, file: str, message: str) -> None:
    (tmp_path / file).write_bytes(np.random.default_rng(0).bytes(3000))
    with pytest.raises(InputError, match=message):
        read(name, tmp_path / file, arm, "t", "/q[*]")


def test_single_numbers_of_a_matlab_file_are_arrays_too(tmp_path: Path) -> None:
    """A period that stands beside the columns is what a proposed map takes the clock from."""
    scipy.io.savemat(tmp_path / "a.mat", {"dt": 0.01, "log": {"q": Q, "rate": 100}, "note": "by hand"})
    found = log_format("mat").read_table(tmp_path / "a.mat", None, lambda _: True)
    assert {name: array.shape for name, array in found.items()} == {"dt": (), "log.q": Q.shape, "log.rate": ()}
    assert (found["dt"], found["log.rate"]) == (0.01, 100)


def test_a_vector_of_one_in_a_lerobot_dataset_is_there_by_its_name(tmp_path: Path) -> None:
    """LeRobot stores such a feature as plain numbers."""
    dataset = write_lerobot(tmp_path / "one")
    info = json.loads((dataset / "meta" / "info.json").read_text())
    info["features"] |= {"timestamp": {"dtype": "float32", "shape": [1], "names": ["since_begin"]}}
    (dataset / "meta" / "info.json").write_text(json.dumps(info))
    found = log_format("lerobot").read_table(dataset, None, lambda _: True)
    assert found["timestamp.since_begin"] == pytest.approx(np.tile(TIME - 5, 2), abs=1e-6)
    assert found["observation.state.shoulder.pos"][:ROWS] == pytest.approx(Q[:, 1], rel=1e-6)


def test_a_missing_date_is_no_number_and_short_integers_do_not_wrap() -> None:
    stamps = np.array(["2024-05-01T00:00:00", "NaT", "2024-05-01T00:00:02"], dtype="M8[ns]")
    table = Table(Path("a"), {"date": stamps, "tick": np.array([-30000, 0, 30000], dtype=np.int16)})
    assert table.instants("date").tolist() == pytest.approx([0.0, np.nan, 2.0], nan_ok=True)
    assert table.instants("tick").tolist() == [0.0, 30000.0, 60000.0]


def test_objects_in_a_list_in_a_record_are_there_by_their_numbers(arm: Robot, tmp_path: Path) -> None:
    """As the state of a robot is written that has a list of motors."""
    records = [{"t": t, "motors": [{"q": q[0]}, {"q": q[1]}]} for t, q in zip(TIME.tolist(), Q.tolist(), strict=True)]
    (tmp_path / "a.jsonl").write_text("\n".join(map(json.dumps, records)))
    assert_right(read("json", tmp_path / "a.jsonl", arm, "t", "motors.*.q"))

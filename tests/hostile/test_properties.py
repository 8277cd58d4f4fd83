"""What holds for any input of a kind: readers, maps, metadata and models, by Hypothesis and by a corpus of files.

The inputs are the same in each run. One that ever failed is kept in ``corpus/``, a file each.
"""

import json
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from leapgap.errors import CONTROL, InputError, printable
from leapgap.logs.files import Header, decoding, unpack
from leapgap.logs.importers import log_format
from leapgap.logs.log import LogInfo
from leapgap.robot.model import Robot
from leapgap.robot.model_count import RefusedError, count
from leapgap.settings import from_mapping, values_of
from tests.hostile.base_logs import ARM

CORPUS = Path(__file__).with_name("corpus")
FORMATS = {"csv": ".csv", "npz": ".npz", "hdf5": ".h5", "mat": ".mat", "pt": ".pt", "parquet": ".parquet"}
HEADS = {
    "csv": b"time,joint_pos/hip\n",
    "npz": b"PK\3\4",
    "hdf5": b"\x89HDF\r\n\x1a\n",
    "mat": b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM",
    "pt": b"PK\3\4",
    "parquet": b"PAR1",
}


def each(number: int) -> Any:
    """So many inputs, the same in each run."""
    checks = [HealthCheck.too_slow, HealthCheck.filter_too_much, HealthCheck.function_scoped_fixture]
    return settings(derandomize=True, database=None, deadline=None, max_examples=number, suppress_health_check=checks)


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as name:
        yield Path(name)


def read_table(name: str, path: Path) -> None:
    """Read a file as a table, as an import does; ``InputError`` is all that may be raised."""
    layout = log_format(name)
    try:
        with decoding(path, name, "export it again"):
            table = layout.table(path, layout.Options())  # type: ignore[attr-defined]
            assert all(isinstance(column, str) for column in table.columns)
    except InputError as refusal:
        assert CONTROL.search(str(refusal)) is None


@given(text=st.text(max_size=40))
@each(200)
def test_what_is_printed_of_others_is_one_plain_line(text: str) -> None:
    assert CONTROL.search(printable(text)) is None and len(printable(text).splitlines()) <= 1
    assert CONTROL.search(str(InputError(text, text, text, text))) is None
    if text.isprintable():
        assert printable(text) == text
    lines = str(InputError("a", "b", "c", "d", [text, text])).split("\n")
    assert len(lines) == 4 and CONTROL.search("".join(lines)) is None


@given(format=st.sampled_from(sorted(FORMATS)), after=st.binary(max_size=400), with_head=st.booleans())
@each(300)
def test_any_bytes_are_a_table_or_a_message(format: str, after: bytes, with_head: bool, folder: Path) -> None:
    path = folder / f"a{FORMATS[format]}"
    path.write_bytes((HEADS[format] if with_head else b"") + after)
    read_table(format, path)


CELL = st.one_of(st.floats().map(str), st.integers().map(str), st.text(max_size=8), st.just("\x1b[31m"))


@given(st.lists(st.lists(CELL, min_size=1, max_size=4), min_size=1, max_size=6))
@each(150)
def test_any_text_table_is_a_table_or_a_message(folder: Path, cells: list[list[str]]) -> None:
    path = folder / "a.csv"
    path.write_bytes("\n".join(",".join(row) for row in cells).encode(errors="surrogatepass"))
    read_table("csv", path)


@pytest.mark.parametrize("path", sorted((CORPUS / "tables").iterdir()), ids=lambda path: path.stem)
def test_tables_that_are_kept_are_tables_or_messages(path: Path) -> None:
    read_table("csv", path)


@given(data=st.binary(max_size=3000), most=st.integers(0, 3000))
@each(200)
def test_unpacking_gives_what_was_packed_or_refuses_more(data: bytes, most: int) -> None:
    import zlib

    if len(data) <= most:
        assert unpack(zlib.compress(data), zlib.decompressobj, "a", most) == data
    else:
        with pytest.raises(InputError, match=f"more than {most} bytes"):
            unpack(zlib.compress(data), zlib.decompressobj, "a", most)


@given(st.binary(max_size=60))
@each(300)
def test_any_bytes_are_a_header_of_a_page_or_an_error_of_one_kind(data: bytes) -> None:
    try:
        page = Header(data)
        fields, length = page.structure(), page.at
    except (IndexError, KeyError, TypeError, ValueError):
        return
    assert isinstance(fields, dict) and length > 0


JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**20), 10**20) | st.floats() | st.text(max_size=10),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=10), inner, max_size=4),
    max_leaves=12,
)
ENTRIES = ("robot", "source", "sample_period_s", "terrain", "segments", "schedule", "target", "load", "derived")
WHOLE = {"format_version": 2, "robot": "arm", "sample_period_s": 0.01, "source": "by hand"}
BOX = st.fixed_dictionaries(
    {"x_m": JSON, "y_m": st.just(0.0), "size_m": st.lists(JSON, min_size=3, max_size=3), "top_m": st.just(0.1)}
)


def check_metadata(text: str) -> None:
    """Metadata are refused, or are what is written of them again."""
    try:
        info = LogInfo.from_json(text, "a log")
    except InputError as refusal:
        assert CONTROL.search(str(refusal)) is None
        return
    assert LogInfo.from_json(info.to_json(), "again") == info
    assert all(min(box.size_m) > 0 for box in info.terrain)
    assert CONTROL.search(info.robot + info.source) is None


@given(entry=st.sampled_from(ENTRIES), value=JSON | st.lists(BOX, max_size=2))
@each(200)
def test_any_metadata_are_refused_or_kept(entry: str, value: Any) -> None:
    check_metadata(json.dumps(WHOLE | {entry: value}))


@pytest.mark.parametrize("path", sorted((CORPUS / "metadata").iterdir()), ids=lambda path: path.stem)
def test_metadata_that_are_kept_are_refused_or_kept(path: Path) -> None:
    check_metadata(path.read_text())


def check_map(path: Path) -> None:
    """A file of options is refused, or says what plain YAML or JSON says."""
    try:
        values = values_of(path)
        from_mapping(log_format("csv").Options, values, str(path))
    except InputError as refusal:
        assert CONTROL.search(str(refusal)) is None


OPTIONS = list(log_format("csv").Options.__dataclass_fields__)


@given(values=st.dictionaries(st.sampled_from(OPTIONS) | st.text(max_size=8), JSON, max_size=3), as_yaml=st.booleans())
@each(250)
def test_any_options_are_refused_or_taken(folder: Path, values: dict[str, Any], as_yaml: bool) -> None:
    path = folder / ("a.yaml" if as_yaml else "a.json")
    path.write_text(yaml.safe_dump(values) if as_yaml else json.dumps(values))
    check_map(path)


@given(st.text(alphabet="ab&*<:[]{}- \n\"'!|>1.e#%@`?,\t\x1b\u202e", max_size=60))
@each(300)
def test_any_yaml_is_refused_or_taken(folder: Path, text: str) -> None:
    path = folder / "b.yaml"
    path.write_text(text)
    check_map(path)


@pytest.mark.parametrize("path", sorted((CORPUS / "maps").iterdir()), ids=lambda path: path.stem)
def test_maps_that_are_kept_are_refused(path: Path) -> None:
    with pytest.raises(InputError):
        from_mapping(log_format("csv").Options, values_of(path), str(path))


PIECES = st.sampled_from(
    [
        *(
            '<geom size="1"/>',
            '<geom name="<!--" size="1"/>',
            '<geom name="-->" size="1"/>',
            "<!--",
            "-->",
            "--",
            "<!-->",
        ),
        *(
            "<![CDATA[",
            "]]>",
            "<?",
            "?>",
            "<?a?>",
            "<!DOCTYPE a>",
            "<!DOCTYPE a [",
            "]>",
            '"',
            "'",
            ">",
            "<",
            "\n",
            " ",
        ),
        *('<geom name="a\nb" size="1"/>', "<geom name='\"' size='1'/>", "&amp;", "&#60;", "&lt;geom/>", "\xe9", "\x00"),
        *('<replicate count="7" offset="1 0 0">', "</replicate>", "<body>", "</body>", '<x:geom size="1"/>'),
        *("<worldbody>", "</worldbody>", "</mujoco>", "<mujoco>", '<geom size="1" size="2"/>', "<geom size=1/>"),
    ]
)


def check_counted(text: bytes, path: Path) -> None:
    """Whatever MuJoCo reads of a text was counted, or the text was refused."""
    try:
        elements = count(path, text).elements
    except RefusedError as refusal:
        assert len(refusal.parts) == 4
        return
    try:
        model = mujoco.MjSpec.from_string(text.decode(errors="surrogateescape")).compile()
    except (ValueError, UnicodeError, TypeError):
        return
    assert elements >= model.ngeom + model.nbody, text


@given(st.lists(PIECES, max_size=6))
@each(500)
def test_what_mujoco_reads_of_a_text_was_counted(pieces: list[str]) -> None:
    check_counted(f"<mujoco><worldbody>{''.join(pieces)}</worldbody></mujoco>".encode(), Path("a.xml"))


@pytest.mark.parametrize("path", sorted((CORPUS / "models").iterdir()), ids=lambda path: path.stem)
def test_models_that_are_kept_are_counted_and_load_or_are_refused(path: Path) -> None:
    check_counted(path.read_bytes(), path)
    try:
        Robot.load(path)
    except InputError as refusal:
        assert CONTROL.search(str(refusal)) is None


VALUE = st.sampled_from(
    ["0", "-1", "1e-7", "1e9", "1e400", "nan", "inf", "1 -1", "", "a", "true", "1 2 3 4 5 6 7", "&#10;"]
)
ATTRIBUTES = (
    *("range", "limited", "axis", "damping", "armature", "frictionloss", "stiffness", "ref", "name", "type", "pos"),
    *("size", "fromto", "quat", "class", "childclass", "mass", "density", "friction", "condim", "user", "group"),
)


@given(st.sampled_from(["joint", "geom", "body", "motor"]), st.sampled_from(ATTRIBUTES), VALUE)
@each(60)
def test_an_arm_with_any_value_loads_as_mujoco_reads_it_or_is_refused(
    folder: Path, tag: str, attribute: str, value: str
) -> None:
    path = folder / "arm.xml"
    at = ARM.index(f"<{tag} ") + len(tag) + 2
    path.write_text(f'{ARM[:at]}{attribute}="{value}" {ARM[at:]}')
    try:
        robot = Robot.load(path)
    except InputError as refusal:
        assert CONTROL.search(str(refusal)) is None
        return
    plain = mujoco.MjModel.from_xml_path(str(path))
    assert np.array_equal(robot.model.body_mass, plain.body_mass)
    assert np.array_equal(robot.model.jnt_range, plain.jnt_range)

"""What a model file asks for is counted before MuJoCo reads it: a file of ten lines can ask for all memory there is.

Bounds are far above any robot: they separate a model from an accident or an attack. Files that a model names may lie
anywhere, as those of real robots do, but each must be a plain file of bounded size: no pipe, device or folder.
"""

import math
import re
import stat
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

from leapgap.errors import InputError

LARGEST_XML_BYTES = 64 << 20
LARGEST_FILE_BYTES = 256 << 20
LARGEST_TOTAL_BYTES = 1 << 30
"""Largest size of a model file, of a mesh, height field or texture, and of all of them together."""
MOST_ELEMENTS = 200_000
"""Largest number of elements of a model after ``replicate`` and ``composite`` have multiplied them."""
DEEPEST = 200
"""Largest number of elements inside one another."""
MOST_FILES = 2000
COPIES = {"replicate": "count", "composite": "count", "flexcomp": "count"}
"""Elements that stand for as many as the product of an attribute says."""
LENGTHS = (
    *("njmax", "nconmax", "nstack", "nuserdata", "nkey"),
    *(f"nuser_{kind}" for kind in ("body", "jnt", "geom", "site", "cam", "tendon", "actuator", "sensor")),
)
SIZES: Mapping[str, tuple[tuple[tuple[str, ...], float], ...]] = {
    "hfield": ((("nrow", "ncol"), 4e6),),
    "texture": ((("width", "height"), 6.4e7),),
    "numeric": ((("size",), 1e6),),
    "user": ((("dim",), 1e6),),
    "sensor": ((("nsample",), 1e6),),
    "mesh": ((("maxhullvert",), 1e6), (("octree_maxdepth",), 10.0), (("params",), 1e6)),
    "size": (*(((name,), 1e6) for name in LENGTHS), (("memory",), float(1 << 30))),
}
"""Element → its attributes whose product is bounded, and the bound."""
FILES = ("file", "filename", *(f"file{side}" for side in ("right", "left", "up", "down", "front", "back")))
"""Attributes that name a file."""
NAMES_XML = ("include", "model")
"""Elements whose file is a model file, too."""
UNITS = {"k": 1 << 10, "m": 1 << 20, "g": 1 << 30, "t": 1 << 40, "p": 1 << 50, "e": 1 << 60}
COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
PNG = b"\x89PNG\r\n\x1a\n"
MOST_PIXELS = 6.4e7
DO = "correct the file, or name another"


@dataclass
class Count:
    """What was counted of a model file and of the files that it includes."""

    main: Path
    elements: float = 0.0
    bytes: int = 0
    files: set[Path] = field(default_factory=set)


def check_model_file(path: Path) -> str:
    """The text of a model file, MJCF or URDF; ``InputError`` where it is none, or asks for too much."""
    text = read_xml(path)
    check_text(text, path)
    return text


def check_text(text: str, path: Path) -> None:
    """Raise ``InputError`` for the text of a model file, read as if at ``path``, that asks for too much."""
    count = Count(path)
    root = parse(text, path)
    check_element(root, path, count, (path.resolve(),), 1.0, 0, folders_of(root))
    if count.elements > MOST_ELEMENTS:
        found = f"{count.elements:.3g} elements after replication"
        raise InputError(path, found, f"{MOST_ELEMENTS} at most", DO)


def read_xml(path: Path) -> str:
    """The text of an XML file; ``InputError`` where it is no plain file, or too large."""
    if not path.exists():
        raise InputError(path, "no such file", "a MuJoCo model (XML) or a URDF", "name the robot's model file")
    size = plain_size(path, path, LARGEST_XML_BYTES)
    if size == 0:
        raise InputError(path, "an empty file", "a MuJoCo model (XML) or a URDF", "name the robot's model file")
    return path.read_text(encoding="utf-8", errors="replace")


def plain_size(path: Path, where: object, largest: int) -> int:
    """Size of a plain file; ``InputError`` for anything else, which may never end, and for a size above ``largest``."""
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else "no plain file (a pipe, a socket or a device)"
        raise InputError(where, f"{path} is {kind}" if path != where else kind, "a plain file", "name the file")
    if status.st_size > largest:
        raise InputError(where, f"{path} has {status.st_size >> 20} MiB", f"{largest >> 20} MiB at most", DO)
    return status.st_size


def parse(text: str, path: Path, of: str = "") -> ElementTree.Element:
    """The top element of an XML text; MuJoCo takes comments that XML forbids, so they are removed before."""
    try:
        return ElementTree.fromstring(COMMENT.sub("", text))
    except (ElementTree.ParseError, ValueError) as error:
        found = f"no valid MuJoCo model{of} ({' '.join(str(error).split())})"
        raise InputError(path, found, "a MuJoCo model (XML) or a URDF", "repair it") from None


def folders_of(root: ElementTree.Element) -> tuple[str, ...]:
    """Folders in which a model looks for its files, beside its own."""
    compilers = list(root.iter("compiler"))
    found = (one.get(name) for one in compilers for name in ("meshdir", "texturedir", "assetdir"))
    return tuple(dict.fromkeys(filter(None, found)))


def check_element(
    element: ElementTree.Element,
    path: Path,
    count: Count,
    inside: tuple[Path, ...],
    copies: float,
    depth: int,
    folders: tuple[str, ...],
) -> None:
    """Count an element and those in it; ``inside`` are the files that include it, and ``copies`` its replications."""
    if depth > DEEPEST:
        raise InputError(path, f"elements more than {DEEPEST} deep in one another", "fewer", DO)
    tag = element.tag if isinstance(element.tag, str) else ""
    if tag in COPIES:
        own = product(element.get(COPIES[tag], "1"))
        if not 0 <= own <= MOST_ELEMENTS:
            raise InputError(path, f"{tag} with {COPIES[tag]}={element.get(COPIES[tag])}", "fewer copies", DO)
        copies *= max(own, 1.0)
    count.elements += copies
    if count.elements > MOST_ELEMENTS:
        found = f"more than {MOST_ELEMENTS} elements after replication, at {tag}"
        raise InputError(path, found, f"{MOST_ELEMENTS} at most", DO)
    check_sizes(element, tag, path)
    for name in FILES:
        if name in element.attrib:
            check_named_file(element, tag, element.get(name, ""), path, count, inside, copies, folders)
    for child in element:
        check_element(child, path, count, inside, copies, depth + 1, folders)


def check_sizes(element: ElementTree.Element, tag: str, path: Path) -> None:
    """Raise ``InputError`` for a size that is above its bound."""
    for names, bound in SIZES.get(tag, ()):
        if any(name in element.attrib for name in names):
            found = math.prod(product(element.get(name, "1")) for name in names)
            if not found <= bound:
                said = ", ".join(f"{name}={element.get(name)}" for name in names if name in element.attrib)
                raise InputError(path, f"{tag} with {said}", f"a size of {bound:g} at most", DO)


def product(text: str) -> float:
    """Product of the numbers of an attribute such as ``10 10 1``, ``5`` or ``2G``; 1 where it holds no number."""
    numbers = re.findall(r"([0-9][0-9.]*(?:[eE][-+]?[0-9]+)?)\s*([kKmMgGtTpPeE]?)(?![0-9])", text)
    try:
        return math.prod(max(1.0, float(value)) * UNITS.get(unit.lower(), 1) for value, unit in numbers)
    except (ValueError, OverflowError):
        return math.inf


def check_named_file(
    element: ElementTree.Element,
    tag: str,
    name: str,
    path: Path,
    count: Count,
    inside: tuple[Path, ...],
    copies: float,
    folders: tuple[str, ...],
) -> None:
    """Check a file that an element names, and what is in it if it is a model file; one that is missing is no matter."""
    for found in candidates(name, path, count.main, folders):
        largest = LARGEST_XML_BYTES if tag in NAMES_XML else LARGEST_FILE_BYTES
        size = plain_size(found, path, largest)
        if tag in NAMES_XML:
            if found in inside:
                chain = " includes ".join(one.name for one in (*inside[inside.index(found) :], found))
                raise InputError(path, f"files that include themselves: {chain}", "an end", "remove the inclusion")
            root = parse(read_xml(found), path, f" in {found}")
            check_element(
                root, found, count, (*inside, found), copies, 1, tuple(dict.fromkeys((*folders, *folders_of(root))))
            )
        elif found not in count.files:
            check_picture(found, path)
            count.bytes += size
        count.files.add(found)
        if count.bytes > LARGEST_TOTAL_BYTES or len(count.files) > MOST_FILES:
            said = f"{len(count.files)} files of {count.bytes >> 20} MiB together"
            raise InputError(path, said, f"{MOST_FILES} files of {LARGEST_TOTAL_BYTES >> 20} MiB at most", DO)


def candidates(name: str, path: Path, main: Path, folders: tuple[str, ...]) -> Iterator[Path]:
    """Existing files that a name may mean, in a model file at ``path`` or in the one that includes it."""
    if not name or "\0" in name or name.startswith("package://"):
        return
    plain = name.removeprefix("file://")
    seen = set[Path]()
    for parent in dict.fromkeys((path.parent, main.parent)):
        for folder in ("", *folders):
            for inner in dict.fromkeys((plain, Path(plain).name)):
                try:
                    found = (parent / folder / inner).resolve()
                    if inner and found not in seen and found.exists() and (inner == plain or found.is_file()):
                        seen.add(found)
                        yield found
                except (OSError, RuntimeError, ValueError):  # a name that is too long, links in a circle
                    continue


def check_picture(path: Path, where: object) -> None:
    """Raise ``InputError`` for a PNG that claims more pixels than a texture has; they are packed well."""
    with path.open("rb") as file:
        head = file.read(24)
    if head.startswith(PNG) and len(head) == 24:
        width, height = struct.unpack(">II", head[16:24])
        if width * height > MOST_PIXELS:
            raise InputError(where, f"{path.name} of {width} × {height} pixels", f"{MOST_PIXELS:g} at most", DO)

"""The readers of point files.

They parse bytes that nobody vouches for: sizes that a header announces are compared with the size of the file before
anything is allocated, nothing is unpickled or evaluated, and nothing depends on the locale.
"""

from touchnet.data.readers.arrays import parse_npy, parse_npz
from touchnet.data.readers.pcd import parse_pcd
from touchnet.data.readers.ply import parse_ply
from touchnet.data.readers.rows import Raw
from touchnet.data.readers.solids import parse_glb, parse_obj, parse_off, parse_stl
from touchnet.data.readers.text import parse_text

__all__ = ["parse"]


def parse(data: bytes, suffix: str, name: str, strict: bool) -> Raw:
    """What the bytes of a file hold; the content chooses the reader, then the suffix.

    Args:
        data: the whole file, not empty.
        suffix: its suffix in lower case, with the dot.
        name: its name, for messages.
        strict: refuse instead of guessing.

    Raises:
        ValueError: one line.
    """
    head = data[:4096]
    word = _first_word(head)
    if head.startswith((b"ply\n", b"ply\r")):
        return parse_ply(data, name)
    if head.startswith(b"\x93NUMPY"):
        return parse_npy(data, name, strict)
    if head.startswith(b"PK\x03\x04"):
        return parse_npz(data, name, strict)
    if head.startswith(b"glTF"):
        return parse_glb(data, name)
    if word in (b"VERSION", b"FIELDS", b"COLUMNS"):
        return parse_pcd(data, name)
    if suffix == ".stl":
        return parse_stl(data, name)
    if word.endswith(b"OFF") and word[:-3].strip(b"STCN4n") == b"":
        return parse_off(data, name)
    if suffix == ".obj":
        return parse_obj(data, name)
    if suffix in (".ply", ".pcd", ".npy", ".npz", ".glb", ".off"):
        raise ValueError(f"{name}: expected a {suffix[1:].upper()} file, found one that starts with {head[:12]!r}")
    return parse_text(data, name, suffix, strict)


def _first_word(head: bytes) -> bytes:
    """The first word on a line that is no comment."""
    for line in head.splitlines():
        words = line.split(None, 1)
        if words and not words[0].startswith(b"#"):
            return words[0]
    return b""

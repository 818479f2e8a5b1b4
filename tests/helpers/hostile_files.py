"""Hostile input files: cut off, deeply nested, with huge numbers, wrong encodings and contradictions."""

from __future__ import annotations

import contextlib
import io
import struct
import uuid
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from helpers.shapes import box_mesh

HUGE = 2**32 - 1


def run(words: list[str]) -> tuple[int, str, str]:
    """Run a command line; return its exit code, its output and its messages."""
    from tacbench_cad.cli import main

    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(words)
    return code, out.getvalue(), err.getvalue()


def nested_3mf(levels: int, width: int, extra: str = "") -> bytes:
    """Return a 3MF file whose item has levels of components, each with ``width`` components."""
    objects, last = "", 1
    for number in range(2, levels + 2):
        parts = f'<component objectid="{last}" p:UUID="{uuid.UUID(int=number)}"/>' * width
        objects += f'<object id="{number}" type="model" p:UUID="{uuid.UUID(int=99 + number)}">'
        objects += f"<components>{parts}</components></object>"
        last = number
    return threemf(objects + extra, f'<item objectid="{last}" p:UUID="{uuid.UUID(int=7)}"/>')


def threemf(
    objects: str = "",
    item: str = '<item objectid="1"/>',
    model: bytes | None = None,
    change: Callable[[bytes], bytes] = lambda model: model,
) -> bytes:
    """Return a 3MF file with a box as object 1, further objects and an item; or with a changed or another model."""
    mesh = box_mesh()
    vertices = "".join('<vertex x="{}" y="{}" z="{}"/>'.format(*point) for point in mesh.vertices.tolist())
    triangles = "".join('<triangle v1="{}" v2="{}" v3="{}"/>'.format(*face) for face in mesh.faces.tolist())
    box = f"<mesh><vertices>{vertices}</vertices><triangles>{triangles}</triangles></mesh>"
    text = (
        '<?xml version="1.0" encoding="UTF-8"?><model unit="millimeter" '
        'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" '
        'xmlns:p="http://schemas.microsoft.com/3dmanufacturing/production/2015/06"><resources>'
        f'<object id="1" type="model" p:UUID="{uuid.UUID(int=1)}">{box}</object>{objects}</resources>'
        f'<build p:UUID="{uuid.UUID(int=5)}">{item}</build></model>'
    )
    rels = (
        '<?xml version="1.0"?><Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
        '<Relationship Target="/3D/3dmodel.model" Id="r" '
        'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>'
    )
    types = (
        '<?xml version="1.0"?><Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
        '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
        '<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>'
    )
    return zip_of(
        {
            "[Content_Types].xml": types.encode(),
            "_rels/.rels": rels.encode(),
            "3D/3dmodel.model": change(text.encode() if model is None else model),
        }
    )


def las(
    records: int = 0, points: int = 0, offset: int = 227, version: int = 2, size: int = 227, tail: bytes = b""
) -> bytes:
    """Return the header of a LAS file with the numbers that it states, and bytes after it."""
    header = bytearray(375 if version == 4 else 227)
    header[:4] = b"LASF"
    header[24:26] = bytes((1, version))
    header[94:111] = struct.pack("<HIIBHI", size, offset, records, 3, 34, points)
    header[131:179] = struct.pack("<6d", 1e-3, 1e-3, 1e-3, 0.0, 0.0, 0.0)
    if version == 4:
        header[235:255] = struct.pack("<QIQ", 2**60, HUGE, 2**60)
    return bytes(header) + tail


def _ply(header: str, body: bytes = b"") -> bytes:
    return f"ply\n{header}\nend_header\n".encode() + body


def _npy(header: str, body: bytes = b"", version: int = 1) -> bytes:
    text = header.encode("latin1") + b"\n"
    return b"\x93NUMPY" + bytes((version, 0)) + struct.pack("<H", len(text)) + text + body


def _png(width: int, height: int, data: bytes = b"") -> bytes:
    def chunk(name: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def _tiff(width: int, height: int, next_directory: int = 0, strip: int = 8) -> bytes:
    entries = [(256, 4, 1, width), (257, 4, 1, height), (258, 3, 1, 16), (259, 3, 1, 1), (262, 3, 1, 1)]
    entries += [(273, 4, 1, strip), (277, 3, 1, 1), (278, 4, 1, height), (279, 4, 1, HUGE)]
    table = b"".join(struct.pack("<HHII", *entry) for entry in entries)
    return b"II*\0" + struct.pack("<I", 8) + struct.pack("<H", len(entries)) + table + struct.pack("<I", next_directory)


def step_of(data: str) -> bytes:
    return (
        "ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'2;1');\nFILE_NAME('','',(''),(''),'','','');\n"
        f"FILE_SCHEMA(('AUTOMOTIVE_DESIGN'));\nENDSEC;\nDATA;\n{data}\nENDSEC;\nEND-ISO-10303-21;\n"
    ).encode("utf-8", "surrogatepass")


def stl_of(count: int, triangles: int, values: float = 0.0) -> bytes:
    body = np.full(triangles * 50, 0, np.uint8)
    rows = body.reshape(-1, 50)[:, :48].copy().view("<f4")
    rows[:] = values
    body.reshape(-1, 50)[:, :48] = rows.view(np.uint8)
    return b"hostile".ljust(80, b"\0") + struct.pack("<I", count) + body.tobytes()


_POINTS = b"".join(b"%d %d %d\n" % (i % 30, i // 30, i % 7) for i in range(600))
_VERTEX = "property float x\nproperty float y\nproperty float z"
_LIST = "property list uchar int vertex_indices"
_NEST = "[" * 5000 + "]" * 5000

#: The content of each file, by its name. The ending decides the command.
FILES: dict[str, Callable[[], bytes]] = {
    "denormal.stl": lambda: stl_of(4, 4, 1e-45),
    "points.stl": lambda: stl_of(2000, 2000, 3.0),
    "solid.stl": lambda: b"solid " + b"\xff" * 5000,
    "utf16.stl": lambda: "solid a\nfacet normal 0 0 1\n".encode("utf-16"),
    "long-number.stl": lambda: b"solid a\nfacet\nvertex " + b"9" * 500_000 + b" 0 0\nendfacet\nendsolid a\n",
    "levels-of-ten.3mf": lambda: nested_3mf(11, 10),
    "chain.3mf": lambda: nested_3mf(3000, 1),
    "items.3mf": lambda: threemf("", '<item objectid="1"/>' * 400),
    "itself.3mf": lambda: threemf('<object id="2"><components><component objectid="2"/></components></object>'),
    "missing.3mf": lambda: threemf("", '<item objectid="77"/>'),
    "entities.3mf": lambda: threemf(
        model=b'<?xml version="1.0"?><!DOCTYPE a ['
        + b"".join(b'<!ENTITY e%d "%s">' % (i, b"&e%d;" % (i - 1) * 10 if i else b"ha" * 10) for i in range(12))
        + b"]><model>&e11;</model>"
    ),
    "external.3mf": lambda: threemf(
        model=b'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]><model>&x;</model>'
    ),
    "deep.3mf": lambda: threemf(model=b"<model>" * 200_000),
    "matrix.3mf": lambda: threemf("", '<item objectid="1" transform="1e38 0 0 0 1e38 0 0 0 1e38 1e38 0 0"/>'),
    "index.3mf": lambda: threemf(
        '<object id="2" type="model"><mesh><vertices><vertex x="0" y="0" z="0"/></vertices><triangles>'
        '<triangle v1="0" v2="4000000000" v3="1"/></triangles></mesh></object>',
        '<item objectid="2"/>',
    ),
    "bomb.3mf": lambda: threemf(model=b" " * 60_000_000),
    "encrypted.3mf": lambda: threemf().replace(
        b"PK\x01\x02\x14\x03\x14\x00\x00\x00", b"PK\x01\x02\x14\x03\x14\x00\x01\x00"
    ),
    "crc.3mf": lambda: flipped(threemf(), -400),
    "itself.step": lambda: step_of("#1=ADVANCED_BREP_SHAPE_REPRESENTATION('',(#1),#1);"),
    "missing.step": lambda: step_of("#1=MANIFOLD_SOLID_BREP('',#999999999);"),
    "number.step": lambda: step_of("#1=CARTESIAN_POINT('',(1.E999,-1.E999,0.));"),
    "nested.step": lambda: step_of("#1=CARTESIAN_POINT('',(" + "(" * 20_000 + ")" * 20_000 + "));"),
    "text.step": lambda: step_of(f"#1=CARTESIAN_POINT('{'x' * 2_000_000}',(0.,0.,0.));"),
    "binary.step": lambda: b"ISO-10303-21;" + bytes(range(256)) * 400 + b"END-ISO-10303-21;",
    "twice.step": lambda: step_of("#1=CARTESIAN_POINT('',(0.,0.,0.));\n" * 500),
    "huge-index.obj": lambda: b"v 0 0 0\nf 1 2 999999999999999999999999\n",
    "wide.obj": lambda: b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf " + b"1 2 3 " * 300_000 + b"\n",
    "mtllib.obj": lambda: b"mtllib ../../../../etc/passwd\nv 0 0 0\nf 1 1 1\n",
    "count.ply": lambda: _ply(f"format binary_little_endian 1.0\nelement vertex {HUGE}\n{_VERTEX}"),
    "list.ply": lambda: _ply(
        f"format binary_little_endian 1.0\nelement vertex 1\n{_VERTEX}\nelement face 2000000000\n{_LIST}", b"\0" * 60
    ),
    "long-list.ply": lambda: _ply(
        "format binary_little_endian 1.0\nelement face 1\nproperty list uint int vertex_indices", b"\xff" * 60
    ),
    "no-end.ply": lambda: b"ply\nformat ascii 1.0\nelement vertex 3\n" + b"comment a\n" * 100_000,
    "properties.ply": lambda: _ply(
        "format ascii 1.0\nelement vertex 3\n" + "\n".join(f"property float p{i}" for i in range(20_000)), b"0\n" * 3
    ),
    "texture.ply": lambda: _ply(
        f"format ascii 1.0\ncomment TextureFile /dev/zero\nelement vertex 1\n{_VERTEX}", b"0 0 0\n"
    ),
    "all-ones.las": lambda: b"LASF" + b"\xff" * 500,
    "records.las": lambda: las(records=HUGE),
    "short.las": lambda: las()[:100],
    "extended.las": lambda: las(version=4, size=375, offset=375),
    "compressed.laz": lambda: las(points=1000, tail=b"\xff" * 5000).replace(b"\x03\x22", b"\x83\x22"),
    "ragged.xyz": lambda: _POINTS + b"1 2\n" + b"1 2 3 4 5\n" * 3,
    "long-line.xyz": lambda: b"1 " * 2_000_000,
    "digits.xyz": lambda: (b"9" * 100_000 + b" 0 0\n") * 20,
    "columns.csv": lambda: b",".join([b"1"] * 100_000) + b"\n",
    "quotes.csv": lambda: b'"' + b"a,b,c\n" * 20_000,
    "shape.npy": lambda: _npy("{'descr': '<f8', 'fortran_order': False, 'shape': (999999999, 999999999), }"),
    "object.npy": lambda: _npy("{'descr': '|O', 'fortran_order': False, 'shape': (5, 5), }", b"\x80\x04."),
    "code.npy": lambda: _npy("__import__('os').system('true')"),
    "cut.npy": lambda: _npy("{'descr': '<f8', 'fortran_order': False, 'shape': (500, 500), }", b"\0" * 80),
    "huge.png": lambda: _png(2**31 - 1, 2**31 - 1),
    "cut.png": lambda: _png(300, 300, zlib.compress(b"\0" * 100)),
    "bomb.png": lambda: _png(50_000, 50_000, zlib.compress(b"\0" * 5_000_000)),
    "huge.tiff": lambda: _tiff(HUGE, HUGE),
    "circle.tiff": lambda: _tiff(40, 40, next_directory=8),
    "nested.toml": lambda: f"[texture]\nname = {_NEST}\n".encode(),
    "number.toml": lambda: b'[texture]\nname = "a"\nfamily = "plane-waves"\n[[wave]]\namplitude = ' + b"9" * 5000,
    "waves.toml": lambda: (
        b'[texture]\nname = "a"\nfamily = "plane-waves"\n'
        + b"[[wave]]\namplitude = 1e300\nf = 1e300\ng = 1e300\n" * 2000
    ),
    "cut.h5": lambda: b"\x89HDF\r\n\x1a\n" + b"\xff" * 900,
    "arrays.npz": lambda: zip_of(
        {"frames.npy": _npy("{'descr': '<f8', 'fortran_order': False, 'shape': (99999999, 9, 9), }")}
    ),
}


def flipped(content: bytes, place: int) -> bytes:
    data = bytearray(content)
    data[place] ^= 0x55
    return bytes(data)


def zip_of(entries: dict[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in entries.items():
            packed.writestr(name, content)
    return stream.getvalue()


def commands(path: Path) -> list[list[str]]:
    """Return the command lines that read a file with this ending."""
    out = str(path.parent / "out")
    scan = ["scan", str(path), "--unit", "mm", "--mm-per-pixel", "0.1", "--block", "2"]
    texture = ["texture-part", str(path), "--at", "0,0,1", "--texture", "2", "--out", f"{out}.stl"]
    match path.suffix:
        case ".stl" | ".3mf":
            return [["check-part", str(path)], texture, scan]
        case ".step":
            return [["check-part", str(path)], texture]
        case ".toml":
            return [["make", "--texture", str(path), "--formats", "stl", "--parts", "blocks", "--out", out]]
        case ".h5" | ".npz":
            return [["import-frames", str(path), "--out", out]]
        case _:
            return [scan]

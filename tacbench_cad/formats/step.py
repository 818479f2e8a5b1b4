"""STEP files by Open CASCADE: solids with names and colours, in millimetres. The same part gives the same bytes.

The schema is AP214 (``AUTOMOTIVE_DESIGN``, ISO 10303-214 IS), because every CAD program reads it. The files contain
curves on surfaces (pcurves). Without these, the kernel takes 2.8 times as long to read the file of texture 4.
"""

from __future__ import annotations

import contextlib
import importlib.util
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tacbench_cad import __version__
from tacbench_cad.formats.step_text import compact, with_blocks
from tacbench_cad.geometry.kernel import location
from tacbench_cad.geometry.part import PrintPart, rgb_of
from tacbench_cad.spec.storage import packed_blocks
from tacbench_cad.util.errors import CheckFailedError, MissingToolError, one_line
from tacbench_cad.util.files import not_empty
from tacbench_cad.util.processes import read_isolated
from tacbench_cad.util.types import Floats
from tacbench_cad.util.untrusted import open_input

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Shape

#: Open CASCADE's name for the schema.
SCHEMA = "AP214IS"
#: The date in every header. It is constant, so that the same part gives the same bytes.
HEADER_DATE = "1980-01-01T00:00:00"
#: The colour of a single part: red, green and blue from 0 to 1 (sRGB).
COLOUR = (0.55, 0.62, 0.70)

#: The time limit of the kernel for an untrusted file, in s, and the additional time for each MB of the file.
MAX_SECONDS, MAX_SECONDS_PER_MB = 120.0, 60.0

_FIRST, _LAST = b"ISO-10303-21;", b"END-ISO-10303-21;"


def why_missing() -> str | None:
    """Return the reason why this machine cannot write STEP files, or None if it can."""
    if importlib.util.find_spec("OCP") is None:
        return 'the Open CASCADE kernel is not installed: pip install "tacbench-cad[cad]"'
    return None


def require_kernel() -> None:
    """Check that the Open CASCADE kernel is available.

    Raises:
        MissingToolError: OCP is not installed, or does not load. On a server without a desktop, it needs libGL and
            libX11.
    """
    if (reason := why_missing()) is not None:
        raise MissingToolError(f"STEP: {reason}")
    try:
        import OCP.gp  # noqa: F401
    except ImportError as error:
        raise MissingToolError(f"STEP: the Open CASCADE kernel does not load ({error}); run tacbench doctor") from None


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Prevent the kernel from printing its statistics to stdout, which is reserved for the output of commands."""
    from OCP.Message import Message, Message_Gravity

    printers = list(Message.DefaultMessenger_s().Printers())
    levels = [printer.GetTraceLevel() for printer in printers]
    for printer in printers:
        printer.SetTraceLevel(Message_Gravity.Message_Fail)
    try:
        yield
    finally:
        for printer, level in zip(printers, levels, strict=True):
            printer.SetTraceLevel(level)


@contextlib.contextmanager
def _settings(name: str, assembly: bool) -> Iterator[None]:
    """Change the kernel's global STEP settings for the writer, and restore them afterwards."""
    from OCP.Interface import Interface_Static

    texts = {"write.step.schema": SCHEMA, "write.step.unit": "MM", "write.step.product.name": name}
    numbers = {"write.surfacecurve.mode": 1, "write.precision.mode": 0, "write.step.assembly": int(assembly)}
    old_texts = {key: Interface_Static.CVal_s(key) for key in texts}
    old_numbers = {key: Interface_Static.IVal_s(key) for key in numbers}
    try:
        for key, text in texts.items():
            Interface_Static.SetCVal_s(key, text)
        for key, number in numbers.items():
            Interface_Static.SetIVal_s(key, number)
        yield
    finally:
        for key, text in old_texts.items():
            Interface_Static.SetCVal_s(key, text)
        for key, number in old_numbers.items():
            Interface_Static.SetIVal_s(key, number)


def write_step(part: PrintPart, path: Path) -> None:
    """Write a part's solid as STEP.

    Args:
        part: The part. Its solid is built if necessary.
        path: The file; see :func:`tacbench_cad.util.files.replacing`.

    Raises:
        InputError: The part has no solid.
        MissingToolError: The kernel is not available.
        OSError: The file cannot be written.
    """
    require_kernel()
    if part.placed:
        write_assembly(part.placed, part.name_in("solid"), part.title, path)
    else:
        write_shape(part.solid[0], part.name_in("solid"), part.title, path)
    parts = [placed for placed, _ in part.placed] or [part]
    blocks = {each.name_in("solid"): each.block for each in parts if each.block is not None}
    if blocks:
        path.write_bytes(with_blocks(path.read_bytes(), packed_blocks(blocks)))


def write_shape(shape: TopoDS_Shape, name: str, title: str, path: Path) -> None:
    """Write a shape of the kernel as STEP; see :func:`write_step`.

    Args:
        shape: The shape, in mm.
        name: The name of the product, in ASCII.
        title: The description in the header, in ASCII.
        path: The file.

    Raises:
        OSError: The file cannot be written.
    """
    document, shapes, colours = _document()
    _named(shapes.AddShape(shape, False), name, COLOUR, colours)
    _write_document(document, name, title, path, assembly=False)
    path.write_bytes(compact(path.read_bytes()))


def write_assembly(placed: Sequence[tuple[PrintPart, Floats]], name: str, title: str, path: Path) -> None:
    """Write an assembly as one STEP file, with a product for each part and a product for the assembly.

    If the assembly contains a part twice, the file has one product for it, which is used twice.

    Args:
        placed: The parts, each with the homogeneous matrix from its own frame to the assembly's frame, shape (4, 4),
            in mm.
        name: The name of the assembly, in ASCII.
        title: The description in the header, in ASCII.
        path: The file.

    Raises:
        InputError: A part has no solid.
        MissingToolError: The kernel is not available.
        OSError: The file cannot be written.
    """
    from OCP.TopLoc import TopLoc_Location

    document, shapes, colours = _document()
    whole = shapes.NewShape()
    _set_name(whole, name)
    labels: dict[str, Any] = {}
    for part, matrix in placed:
        own, product = part.solid[0].Location(), part.name_in("solid")
        if product not in labels:
            # The shape must not have a location of its own: otherwise the kernel makes a product without a name.
            labels[product] = shapes.AddShape(part.solid[0].Located(TopLoc_Location()), False)
            _named(labels[product], product, rgb_of(part.kind), colours)
        _set_name(shapes.AddComponent(whole, labels[product], location(matrix) * own), product)
    shapes.UpdateAssemblies()
    _write_document(document, name, title, path, assembly=True)
    path.write_bytes(compact(_styles_in_order(path.read_bytes())))


def _styles_in_order(text: bytes) -> bytes:
    """Return the text of a STEP file with the colours in the order of the products.

    The kernel writes the colours at the end, in an order that differs from run to run. This function follows the
    references of each colour, beginning at its first entity, and renumbers the entities.
    """
    begin = text.index(b"#", text.rindex(b";", 0, text.index(b"= MECHANICAL_DESIGN_GEOMETRIC")))
    end = text.index(b"ENDSEC;", begin)
    bodies = {
        int(n): b" ".join(body.split()) for n, body in re.findall(rb"#(\d+) = (.*?);", text[begin:end], re.DOTALL)
    }
    heads = [n for n, body in bodies.items() if body.startswith(b"MECHANICAL_DESIGN_GEOMETRIC")]
    order: dict[int, int] = {}

    def visit(number: int) -> None:
        if number in bodies and number not in order:
            order[number] = min(bodies) + len(order)
            for reference in re.findall(rb"#(\d+)", bodies[number]):
                visit(int(reference))

    for head in sorted(heads, key=lambda n: int(bodies[n].rpartition(b"#")[2].rstrip(b")"))):
        visit(head)
    lines = [
        b"#%d = %s;\n" % (order[n], re.sub(rb"#(\d+)", lambda m: b"#%d" % order.get(int(m[1]), int(m[1])), bodies[n]))
        for n in order
    ]
    return text[:begin] + b"".join(lines) + text[end:]


def _document() -> tuple[Any, Any, Any]:
    """Return a new document of the kernel, with its shape tool and its colour tool."""
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDocStd import TDocStd_Document
    from OCP.XCAFApp import XCAFApp_Application
    from OCP.XCAFDoc import XCAFDoc_DocumentTool

    document = TDocStd_Document(TCollection_ExtendedString("XmlOcaf"))
    XCAFApp_Application.GetApplication_s().InitDocument(document)
    main = document.Main()
    return document, XCAFDoc_DocumentTool.ShapeTool_s(main), XCAFDoc_DocumentTool.ColorTool_s(main)


def _set_name(label: Any, name: str) -> None:
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDataStd import TDataStd_Name

    TDataStd_Name.Set_s(label, TCollection_ExtendedString(name))


def _named(label: Any, name: str, colour: tuple[float, float, float], colours: Any) -> None:
    from OCP.Quantity import Quantity_Color, Quantity_TypeOfColor
    from OCP.XCAFDoc import XCAFDoc_ColorType

    _set_name(label, name)
    shown = Quantity_Color(*colour, Quantity_TypeOfColor.Quantity_TOC_sRGB)
    colours.SetColor(label, shown, XCAFDoc_ColorType.XCAFDoc_ColorGen)


def _write_document(document: Any, name: str, title: str, path: Path, *, assembly: bool) -> None:
    from OCP.IFSelect import IFSelect_ReturnStatus
    from OCP.STEPCAFControl import STEPCAFControl_Writer
    from OCP.STEPControl import STEPControl_Controller, STEPControl_StepModelType

    STEPControl_Controller.Init_s()
    with _quiet(), _settings(name, assembly):
        writer = STEPCAFControl_Writer()
        writer.SetNameMode(True)
        writer.SetColorMode(True)
        writer.Transfer(document, STEPControl_StepModelType.STEPControl_AsIs)
        if assembly:
            _number_uses(writer)
        _set_header(writer, name, title)
        status = writer.Write(str(path))
    if status != IFSelect_ReturnStatus.IFSelect_RetDone or not path.is_file():
        raise OSError(f"the kernel could not write the STEP file ({status})")


def _number_uses(writer: object) -> None:
    """Number the uses of parts from 1. Otherwise the kernel continues the numbers of the process's previous file."""
    from OCP.StepRepr import StepRepr_NextAssemblyUsageOccurrence
    from OCP.TCollection import TCollection_HAsciiString as Text

    model = writer.ChangeWriter().Model()  # type: ignore[attr-defined]
    number = 0
    for i in range(1, model.NbEntities() + 1):
        entity = model.Value(i)
        if isinstance(entity, StepRepr_NextAssemblyUsageOccurrence):
            number += 1
            entity.SetId(Text(str(number)))


def _set_header(writer: object, name: str, title: str) -> None:
    """Write a header that names no date, person or machine."""
    from OCP.APIHeaderSection import APIHeaderSection_MakeHeader
    from OCP.TCollection import TCollection_HAsciiString as Text

    header = APIHeaderSection_MakeHeader(writer.ChangeWriter().Model())  # type: ignore[attr-defined]
    header.SetName(Text(name))
    header.SetTimeStamp(Text(HEADER_DATE))
    header.SetAuthorValue(1, Text(""))
    header.SetOrganizationValue(1, Text(""))
    header.SetOriginatingSystem(Text(f"tacbench-cad {__version__}"))
    header.SetAuthorisation(Text(""))
    header.SetDescriptionValue(1, Text(title.encode("ascii", "replace").decode("ascii")))


def with_kernel(path: Path, function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function that reads an untrusted STEP file in a child process; same errors as :func:`.read_isolated`."""
    return read_isolated(path, "the CAD kernel", (MAX_SECONDS, MAX_SECONDS_PER_MB), function, *arguments)


@contextlib.contextmanager
def kernel_errors(path: Path) -> Iterator[None]:
    """Replace exceptions of the kernel by a CheckFailedError with a message for the user.

    Raises:
        CheckFailedError: The kernel raised an exception.
    """
    try:
        yield
    except Exception as error:
        if not type(error).__module__.startswith("OCP"):
            raise
        detail = one_line(error, 200) or type(error).__name__
        raise CheckFailedError(f"{path}: the CAD kernel refuses this STEP file: {detail}") from error


def read_step(path: Path) -> TopoDS_Shape:
    """Read the shape of a STEP file, in millimetres.

    Args:
        path: The file.

    Returns:
        The root shape, or a compound if the file has several root shapes.

    Raises:
        InputError: The file does not exist, or is a folder.
        MissingToolError: The kernel is not available.
        CheckFailedError: The file is empty, incomplete, not a STEP file, or contains no shape.
    """
    _require_step(not_empty(path))
    require_kernel()
    from OCP.IFSelect import IFSelect_ReturnStatus
    from OCP.STEPControl import STEPControl_Reader

    with kernel_errors(path), _quiet():
        reader = STEPControl_Reader()
        if reader.ReadFile(str(path)) != IFSelect_ReturnStatus.IFSelect_RetDone:
            raise CheckFailedError(f"{path}: the kernel cannot read this STEP file")
        reader.TransferRoots()
        if reader.NbShapes() == 0:
            raise CheckFailedError(f"{path}: the STEP file contains no shape")
        return reader.OneShape()


def require_readable(path: Path) -> None:
    """Check that the kernel can read an untrusted file. A child process reads it, in case it crashes the kernel.

    Raises:
        InputError: Same as for :func:`with_kernel`.
        CheckFailedError: Same as for :func:`read_step`.
    """
    with_kernel(path, _probe, path)


def _probe(path: Path) -> None:
    read_step(path)


def read_parts(path: Path) -> list[tuple[str, TopoDS_Shape]]:
    """Read the parts of an assembly in the assembly's frame, in millimetres.

    Args:
        path: The file.

    Returns:
        For each use of a part, the name of its product (empty if it has none) and its shape, in the order of the file.
        If the file is not an assembly, the list has one item for each root shape.

    Raises:
        InputError: Same as for :func:`read_step`.
        MissingToolError: Same as for :func:`read_step`.
        CheckFailedError: Same as for :func:`read_step`.
    """
    _require_step(not_empty(path))
    require_kernel()
    from OCP.IFSelect import IFSelect_ReturnStatus
    from OCP.STEPCAFControl import STEPCAFControl_Reader
    from OCP.TDF import TDF_LabelSequence
    from OCP.TopLoc import TopLoc_Location

    document, shapes, _ = _document()
    with kernel_errors(path), _quiet():
        reader = STEPCAFControl_Reader()
        reader.SetNameMode(True)
        if reader.ReadFile(str(path)) != IFSelect_ReturnStatus.IFSelect_RetDone or not reader.Transfer(document):
            raise CheckFailedError(f"{path}: the kernel cannot read this STEP file")
    roots = TDF_LabelSequence()
    shapes.GetFreeShapes(roots)
    return [part for i in range(1, roots.Length() + 1) for part in _parts(roots.Value(i), TopLoc_Location())]


def _parts(label: Any, place: Any) -> Iterator[tuple[str, TopoDS_Shape]]:
    """Yield the parts below a label of the document. Assemblies are divided into their parts."""
    from OCP.TDataStd import TDataStd_Name
    from OCP.TDF import TDF_Label, TDF_LabelSequence
    from OCP.XCAFDoc import XCAFDoc_ShapeTool

    if not XCAFDoc_ShapeTool.IsAssembly_s(label):
        name = TDataStd_Name()
        has_name = label.FindAttribute(TDataStd_Name.GetID_s(), name)
        yield name.Get().ToExtString() if has_name else "", XCAFDoc_ShapeTool.GetShape_s(label).Moved(place)
        return
    uses = TDF_LabelSequence()
    XCAFDoc_ShapeTool.GetComponents_s(label, uses, False)
    for i in range(1, uses.Length() + 1):
        used = TDF_Label()
        XCAFDoc_ShapeTool.GetReferredShape_s(uses.Value(i), used)
        yield from _parts(used, place * XCAFDoc_ShapeTool.GetLocation_s(uses.Value(i)))


def _require_step(path: Path) -> None:
    """Check that a file has the first and the last line of a STEP file. The kernel can crash on other files."""
    with open_input(path, kind="step") as stream:
        head = stream.read(1024)
        stream.seek(max(0, stream.seek(0, 2) - 1024))
        tail = stream.read()
    if not head.lstrip().upper().startswith(_FIRST):
        raise CheckFailedError(f'{path}: this is not a STEP file; a STEP file begins with "{_FIRST.decode()}"')
    if _LAST not in tail.upper():
        raise CheckFailedError(f'{path}: the STEP file is incomplete; its last line "{_LAST.decode()}" is missing')

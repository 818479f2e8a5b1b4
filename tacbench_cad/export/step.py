"""STEP by Open CASCADE: one solid with its name and colour, in millimetres, the same bytes for the same part.

Schema: AP214 (``AUTOMOTIVE_DESIGN``, ISO 10303-214 IS), the one that every CAD program reads. Curves on surfaces
(pcurves) are written: without them the file of texture 4 is 4 % smaller and takes the kernel 2.8 times as long to read.
"""

from __future__ import annotations

import contextlib
import importlib.util
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from tacbench_cad import __version__
from tacbench_cad.errors import CheckFailedError, MissingToolError
from tacbench_cad.files import not_empty
from tacbench_cad.part import Part

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Shape

#: The schema as Open CASCADE calls it.
SCHEMA = "AP214IS"
#: The date in every header: the files hold no time, so that the same part gives the same bytes.
HEADER_DATE = "1980-01-01T00:00:00"
#: Colour of every part, sRGB from 0 to 1.
COLOUR = (0.55, 0.62, 0.70)

_FIRST, _LAST = b"ISO-10303-21;", b"END-ISO-10303-21;"


def why_missing() -> str | None:
    """Why STEP cannot be written on this machine, or None."""
    if importlib.util.find_spec("OCP") is None:
        return 'the Open CASCADE kernel is not installed: pip install "tacbench-cad[cad]"'
    return None


def require_kernel() -> None:
    """Refuse where there is no kernel.

    Raises:
        MissingToolError: OCP is not installed or does not load (on a bare server it needs libGL and libX11).
    """
    if (reason := why_missing()) is not None:
        raise MissingToolError(f"STEP: {reason}")
    try:
        import OCP.gp  # noqa: F401
    except ImportError as error:
        raise MissingToolError(f"STEP: the Open CASCADE kernel does not load ({error}); run tacbench doctor") from None


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep the kernel from printing its statistics on stdout, where a command's answer stands."""
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
def _settings(name: str) -> Iterator[None]:
    """The kernel's global STEP settings as this file needs them, and afterwards as they were."""
    from OCP.Interface import Interface_Static

    texts = {"write.step.schema": SCHEMA, "write.step.unit": "MM", "write.step.product.name": name}
    numbers = {"write.surfacecurve.mode": 1, "write.precision.mode": 0, "write.step.assembly": 0}
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


def write_step(part: Part, path: Path) -> None:
    """Write a part's solid as STEP.

    Args:
        part: The part; its solid is built if it is not yet.
        path: The file; see :func:`tacbench_cad.files.replacing`.

    Raises:
        InputError: The part has no solid.
        MissingToolError: There is no kernel.
        OSError: The file could not be written.
    """
    require_kernel()
    solid, _ = part.solid
    write_shape(solid, part.name, part.title, path)


def write_shape(shape: TopoDS_Shape, name: str, title: str, path: Path) -> None:
    """Write any shape of the kernel as STEP; see :func:`write_step`.

    Args:
        shape: The shape, in mm.
        name: The product's name, ASCII.
        title: The header's description, ASCII.
        path: The file.

    Raises:
        OSError: The file could not be written.
    """
    from OCP.IFSelect import IFSelect_ReturnStatus
    from OCP.Quantity import Quantity_Color, Quantity_TypeOfColor
    from OCP.STEPCAFControl import STEPCAFControl_Writer
    from OCP.STEPControl import STEPControl_Controller, STEPControl_StepModelType
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDataStd import TDataStd_Name
    from OCP.TDocStd import TDocStd_Document
    from OCP.XCAFApp import XCAFApp_Application
    from OCP.XCAFDoc import XCAFDoc_ColorType, XCAFDoc_DocumentTool

    document = TDocStd_Document(TCollection_ExtendedString("XmlOcaf"))
    XCAFApp_Application.GetApplication_s().InitDocument(document)
    label = XCAFDoc_DocumentTool.ShapeTool_s(document.Main()).AddShape(shape, False)
    TDataStd_Name.Set_s(label, TCollection_ExtendedString(name))
    colour = Quantity_Color(*COLOUR, Quantity_TypeOfColor.Quantity_TOC_sRGB)
    XCAFDoc_DocumentTool.ColorTool_s(document.Main()).SetColor(label, colour, XCAFDoc_ColorType.XCAFDoc_ColorGen)
    STEPControl_Controller.Init_s()
    with _quiet(), _settings(name):
        writer = STEPCAFControl_Writer()
        writer.SetNameMode(True)
        writer.SetColorMode(True)
        writer.Transfer(document, STEPControl_StepModelType.STEPControl_AsIs)
        _set_header(writer, name, title)
        status = writer.Write(str(path))
    if status != IFSelect_ReturnStatus.IFSelect_RetDone or not path.is_file():
        raise OSError(f"the kernel could not write the STEP file ({status})")


def _set_header(writer: object, name: str, title: str) -> None:
    """A header without date, person or machine."""
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


def read_step(path: Path) -> TopoDS_Shape:
    """Read a STEP file's shape, in millimetres.

    Args:
        path: The file.

    Returns:
        Its root shape, or a compound of several.

    Raises:
        InputError: There is no such file, or it is a folder.
        MissingToolError: There is no kernel.
        CheckFailedError: The file is empty, cut off, no STEP, or holds no shape.
    """
    _require_step(not_empty(path))
    require_kernel()
    from OCP.IFSelect import IFSelect_ReturnStatus
    from OCP.STEPControl import STEPControl_Reader

    with _quiet():
        reader = STEPControl_Reader()
        if reader.ReadFile(str(path)) != IFSelect_ReturnStatus.IFSelect_RetDone:
            raise CheckFailedError(f"{path}: the kernel cannot read this STEP file")
        reader.TransferRoots()
        if reader.NbShapes() == 0:
            raise CheckFailedError(f"{path}: the STEP file holds no shape")
        return reader.OneShape()


def _require_step(path: Path) -> None:
    """Refuse a file without STEP's first or last line before the kernel, which may end badly on it, sees it."""
    with path.open("rb") as stream:
        head = stream.read(1024)
        stream.seek(max(0, path.stat().st_size - 1024))
        tail = stream.read()
    if not head.lstrip().upper().startswith(_FIRST):
        raise CheckFailedError(f'{path}: this is no STEP file; one begins with "{_FIRST.decode()}"')
    if _LAST not in tail.upper():
        raise CheckFailedError(f'{path}: the STEP file is cut off; its last line "{_LAST.decode()}" is missing')

"""The packages that the project can use: their versions, and the commands that install them.

Importing this module imports none of them.
"""

from __future__ import annotations

import importlib.util
import os
from dataclasses import dataclass

from tacbench_cad.util.errors import MissingToolError


@dataclass(frozen=True, kw_only=True)
class Package:
    """A package that the project can use.

    Args:
        distribution: The name by which it is installed.
        module: The name by which it is imported.
        extra: The extra that installs it; None for the base installation.
        use: What the project uses it for.
    """

    distribution: str
    module: str
    extra: str | None
    use: str

    @property
    def version(self) -> str | None:
        """The installed version, or None."""
        return version(self.distribution)


#: The packages that may be missing.
PACKAGES: tuple[Package, ...] = (
    Package(distribution="numpy", module="numpy", extra=None, use="all calculations"),
    Package(distribution="scipy", module="scipy", extra=None, use="splines and sparse matrices"),
    Package(distribution="manifold3d", module="manifold3d", extra=None, use="checks of every mesh"),
    Package(distribution="lib3mf", module="lib3mf", extra=None, use="3MF files"),
    Package(distribution="rich-click", module="rich_click", extra=None, use="the commands"),
    Package(distribution="rich", module="rich", extra=None, use="tables and progress"),
    Package(distribution="cadquery", module="cadquery", extra="cad", use="the CadQuery plugin"),
    Package(distribution="build123d", module="build123d", extra="cad", use="the build123d plugin"),
    Package(
        distribution="cadquery-ocp", module="OCP", extra="cad", use="the Open CASCADE kernel: STEP files, fixtures"
    ),
    Package(distribution="pymeshlab", module="pymeshlab", extra="cad", use="--verify full and tacbench check-part"),
    Package(distribution="matplotlib", module="matplotlib", extra="plot", use="preview.png and tacbench show"),
    Package(distribution="pillow", module="PIL", extra="images", use="pictures as height maps"),
    Package(distribution="surfalize", module="surfalize", extra="instruments", use="height maps of instruments"),
    Package(distribution="trimesh", module="trimesh", extra="scan", use="scans in PLY files"),
    Package(distribution="laspy", module="laspy", extra="scan", use="scans in LAS files"),
    Package(distribution="k3d", module="k3d", extra="view", use="the 3D pages of tacbench view and design"),
    Package(distribution="starlette", module="starlette", extra="web", use="the page of tacbench design"),
    Package(distribution="uvicorn", module="uvicorn", extra="web", use="the server of that page"),
    Package(distribution="websockets", module="websockets", extra="web", use="the messages of that page"),
    Package(distribution="pyserial", module="serial", extra="lab", use="stages and gauges on a serial port"),
    Package(distribution="opencv-python-headless", module="cv2", extra="lab", use="cameras and images of a data run"),
    Package(distribution="pandas", module="pandas", extra="analysis", use="tables of results"),
    Package(distribution="scikit-learn", module="sklearn", extra="analysis", use="classifiers and their scores"),
    Package(distribution="joblib", module="joblib", extra=None, use="work in several processes"),
    Package(distribution="jinja2", module="jinja2", extra="analysis", use="the page of tacbench report"),
    Package(distribution="pyarrow", module="pyarrow", extra="export", use="export-runs --to huggingface"),
    Package(distribution="zarr", module="zarr", extra="export", use="export-runs --to zarr"),
    Package(distribution="rocrate", module="rocrate", extra="publish", use="tacbench publish"),
    Package(distribution="torch", module="torch", extra="cnn", use="convolutional networks (examples)"),
    Package(distribution="skorch", module="skorch", extra="cnn", use="PyTorch for scikit-learn (examples)"),
    Package(distribution="distributed", module="distributed", extra="dask", use="analysis on a Dask cluster"),
)


def version(distribution: str) -> str | None:
    """The installed version of a distribution, or None."""
    import importlib.metadata  # slow to import, and most commands do not need it

    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


def has_module(name: str) -> bool:
    """Whether a top-level module is installed; it is not imported."""
    return importlib.util.find_spec(name) is not None


def install_command(extra: str | None) -> str:
    """Return the command that installs an extra, or repairs the base installation."""
    return f'pip install "tacbench-cad[{extra}]"' if extra else "pip install --force-reinstall tacbench-cad"


def why_missing(*modules: str) -> str | None:
    """Name the missing packages and the command that installs them.

    Args:
        modules: The import names of the needed packages, which must be in :data:`PACKAGES`.

    Returns:
        The end of an error message, or None if all packages are installed.
    """
    known = {package.module: package for package in PACKAGES}
    missing = [known[name] for name in modules if not has_module(name)]
    if not missing:
        return None
    names = ", ".join(package.distribution for package in missing)
    return f"needs {names}, not installed: run {install_command(missing[0].extra)}"


def require(what: str, *modules: str) -> None:
    """Check that packages are installed before work begins.

    Args:
        what: The feature that needs the packages, as the beginning of the error message.
        modules: Same as for :func:`why_missing`. The message names the extra of the first missing package.

    Raises:
        MissingToolError: A module is missing.
    """
    reason = why_missing(*modules)
    if reason is not None:
        raise MissingToolError(f"{what} {reason}")


def why_not_imported(error: ModuleNotFoundError) -> str | None:
    """Explain a failed import of one of :data:`PACKAGES` and name the remedy; None for any other module."""
    module = (error.name or "").split(".")[0]
    return why_missing(module) if any(package.module == module for package in PACKAGES) else None


def quiet_opencv() -> None:
    """Switch off the warnings that OpenCV and its libraries print to the standard error output.

    Raises:
        ImportError: OpenCV is not installed.
    """
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    import cv2

    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)

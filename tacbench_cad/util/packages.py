"""What is installed: packages, their versions and the command that brings a missing one. Importing it imports none."""

from __future__ import annotations

import importlib.util
import os
from dataclasses import dataclass

from tacbench_cad.util.errors import MissingToolError


@dataclass(frozen=True, kw_only=True)
class Package:
    """Something that the project can use.

    Args:
        distribution: Name to install it by.
        module: Name to import it by.
        extra: The extra that brings it; None for the base install.
        use: What it is for.
    """

    distribution: str
    module: str
    extra: str | None
    use: str

    @property
    def version(self) -> str | None:
        """The installed version, or None."""
        return version(self.distribution)


#: The packages that may be missing, and what brings them.
PACKAGES: tuple[Package, ...] = (
    Package(distribution="numpy", module="numpy", extra=None, use="all numbers"),
    Package(distribution="scipy", module="scipy", extra=None, use="splines and sparse tables"),
    Package(distribution="manifold3d", module="manifold3d", extra=None, use="checks of every mesh"),
    Package(distribution="lib3mf", module="lib3mf", extra=None, use="3MF files"),
    Package(distribution="rich-click", module="rich_click", extra=None, use="the commands"),
    Package(distribution="rich", module="rich", extra=None, use="tables and progress"),
    Package(distribution="cadquery", module="cadquery", extra="cad", use="the CadQuery plugin"),
    Package(distribution="build123d", module="build123d", extra="cad", use="holder, jig, coupon; the build123d plugin"),
    Package(
        distribution="cadquery-ocp", module="OCP", extra="cad", use="the Open CASCADE kernel: STEP files, fixtures"
    ),
    Package(distribution="pymeshlab", module="pymeshlab", extra="cad", use="--verify full and tacbench check-part"),
    Package(distribution="matplotlib", module="matplotlib", extra="plot", use="preview.png and tacbench show"),
    Package(distribution="k3d", module="k3d", extra="view", use="the 3D page of tacbench view"),
    Package(distribution="pyserial", module="serial", extra="lab", use="stages and gauges on a serial port"),
    Package(distribution="opencv-python-headless", module="cv2", extra="lab", use="cameras and images of a data run"),
    Package(distribution="scikit-learn", module="sklearn", extra="analysis", use="classifiers and their scores"),
    Package(distribution="joblib", module="joblib", extra="analysis", use="analysis on several processors"),
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
    import importlib.metadata  # costs as much as a table; most commands do not ask

    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


def has_module(name: str) -> bool:
    """Whether a top-level module can be found; it is not imported."""
    return importlib.util.find_spec(name) is not None


def install_command(extra: str | None) -> str:
    """The command that installs an extra, or repairs the base install."""
    return f'pip install "tacbench-cad[{extra}]"' if extra else "pip install --force-reinstall tacbench-cad"


def why_missing(*modules: str) -> str | None:
    """Why something that needs these modules cannot be had: what is missing, and the command that installs it.

    Args:
        modules: Import names, all of them in :data:`PACKAGES`.

    Returns:
        The reason, or None when all are there.
    """
    known = {package.module: package for package in PACKAGES}
    missing = [known[name] for name in modules if not has_module(name)]
    if not missing:
        return None
    names = ", ".join(package.distribution for package in missing)
    return f"needs {names}, not installed: {install_command(missing[0].extra)}"


def require(what: str, *modules: str) -> None:
    """Refuse something before it has begun.

    Args:
        what: What needs the modules, as the beginning of the message.
        modules: As of :func:`why_missing`; the first that is missing decides which extra is named.

    Raises:
        MissingToolError: A module is missing.
    """
    reason = why_missing(*modules)
    if reason is not None:
        raise MissingToolError(f"{what} {reason}")


def why_not_imported(error: ModuleNotFoundError) -> str | None:
    """Why an import failed, and what helps, if it was of one of :data:`PACKAGES`; else None."""
    module = (error.name or "").split(".")[0]
    return why_missing(module) if any(package.module == module for package in PACKAGES) else None


def quiet_opencv() -> None:
    """Keep OpenCV and the libraries behind it from printing warnings of their own before our message.

    Raises:
        ImportError: It is not installed.
    """
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    import cv2

    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)

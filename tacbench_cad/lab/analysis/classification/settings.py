"""The settings of a classification, and the estimators by name."""

from __future__ import annotations

import hashlib
import inspect
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Len

from tacbench_cad import __version__
from tacbench_cad.lab.analysis.classification.augment import PAPER_COPIES, Augmentation
from tacbench_cad.lab.analysis.classification.splits import FOLDS, HOLD_OUT_LEVELS, UNITS
from tacbench_cad.lab.analysis.feature import Feature, feature_of
from tacbench_cad.lab.analysis.pixels import AS_PUBLISHED
from tacbench_cad.lab.analysis.tables import write_settings
from tacbench_cad.lab.rig.plugin import is_plugin, load
from tacbench_cad.util.convert import check_fields, read_json
from tacbench_cad.util.errors import InputError, TacbenchError, nearest, one_of
from tacbench_cad.util.untrusted import read_bytes

#: The built-in estimators: the paper's two.
ESTIMATORS = ("forest", "network")
#: The number of neurons in a hidden layer of the network.
HIDDEN = 50
#: The version of the algorithm. Raise it with every change that gives other results for the same settings and data:
#: trials that were stored by an older version are then computed again.
ALGORITHM = 1
#: The name of the settings file beside the tables.
SETTINGS_FILE = "classification_settings.json"
#: The names of the protocols.
Protocol = Literal["leak-free", "paper", "as-published"]
#: The settings of each estimator in the saved cells of the authors' notebooks. They also use one noisy copy of each
#: image.
SAVED: Mapping[str, Mapping[str, Any]] = {
    "forest": {"components": 25},
    "network": {"components": 45, "epochs": 15_000, "batch_size": 64},
}


@dataclass(frozen=True, kw_only=True)
class ClassificationSettings:
    """The settings of a classification. Together with the data they determine all results.

    Args:
        protocol: ``leak-free`` keeps the test set completely out of training. ``paper`` follows the paper's text, and
            ``as-published`` the notebooks' cells that computed the printed accuracies.
        estimators: ``forest``, ``network`` or ``module:name``.
        resolution: The fraction of an image's width and height that remains.
        components: The number of principal components that the estimators receive; None for the frames themselves.
        augmentation: The copies that are added to training frames. The paper's protocols need
            :data:`~tacbench_cad.lab.analysis.classification.augment.PAPER_COPIES`, which :func:`usual` returns.
        clip: Round and clip the copies to whole counts from 0 to 255, as in image files (``paper`` only).
        seed: The seed. All random numbers follow from it and the number of the trial.
        hold_out: The hold-out levels (``leak-free`` only).
        folds: The number of folds of presses and of positions (``leak-free`` only).
        copies: The number of prints of each texture and combination in training; None for all (``leak-free`` only).
        epochs: The number of epochs of the network.
        batch_size: The number of rows in a step of the network.
        depth: The maximum depth of the forest's trees.
        train_on: The training combinations, used one at a time (not ``leak-free``).
        features: The feature that is classified, see :func:`~tacbench_cad.lab.analysis.feature.feature_of`.
        series: Whether all frames of a press's series are classified together, instead of the frame of the press.
        frames: The number of frames that are used from the start of each series; None for all.
        roi: The region of interest in the form of ``--roi``; None for the region that is stored with the runs.

    Raises:
        InputError: A value is not allowed.
    """

    protocol: Protocol = "leak-free"
    estimators: tuple[str, ...] = ("forest",)
    resolution: float = 0.4
    components: Annotated[int, Ge(1)] | None = 25
    augmentation: Augmentation = field(default_factory=Augmentation)
    clip: bool = False
    seed: Annotated[int, Ge(0)] = 0
    hold_out: tuple[str, ...] = HOLD_OUT_LEVELS
    folds: Annotated[int, Ge(2)] = FOLDS
    copies: Annotated[int, Ge(1)] | None = None
    epochs: Annotated[int, Ge(1)] = 1500
    batch_size: Annotated[int, Ge(1)] = 200
    depth: Annotated[int, Ge(1)] = 50
    train_on: tuple[str, ...] = ()
    features: str = "pixels"
    series: bool = False
    frames: Annotated[int, Ge(1)] | None = None
    roi: str | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        for name in self.estimators:
            if not is_plugin(name) and name not in ESTIMATORS:
                hint = nearest(name, ESTIMATORS)
                raise InputError("estimator", name, f"must be forest, network or module:name; {hint}")
        if not self.estimators or len(set(self.estimators)) < len(self.estimators):
            raise InputError("estimator", list(self.estimators), "must be one or more different names")
        for level in self.hold_out:
            one_of("hold-out", level, UNITS)
        if self.protocol != "leak-free" and self.components is None:
            raise InputError("components", "none", "must be a number for the paper's protocol, for example 25")
        if self.clip and self.protocol != "paper":
            raise InputError("clip", True, "is for --protocol paper only; the other protocols do not clip their copies")
        if self.protocol == "as-published" and self.series:
            raise InputError("protocol", self.protocol, "is for the frames of presses; leave out --series")
        if self.protocol == "as-published" and (self.features != "pixels" or self.roi is not None):
            raise InputError(
                "protocol", self.protocol, "uses the pixels of whole images; leave out --features and --roi"
            )
        if self.protocol == "as-published" and len(self.estimators) > 1:
            what = "must be a single name, because the saved cells have other settings for each; classify twice"
            raise InputError("estimator", ",".join(self.estimators), what)

    @property
    def feature(self) -> Feature:
        """The feature, not fitted yet."""
        if self.protocol == "as-published":
            return replace(AS_PUBLISHED, resolution=self.resolution, edges=True)
        return feature_of(self.features, resolution=self.resolution)

    def key(self, data: str) -> str:
        """Return a key of the results that follow from these settings, the data and the versions of the programs.

        Args:
            data: The key of the data, see :attr:`~tacbench_cad.lab.analysis.collection.Collection.data_key`.
        """
        import sklearn

        programs = [ALGORITHM, __version__, np.__version__, sklearn.__version__]
        sources = [_source(name) for name in self.estimators if is_plugin(name)]
        text = json.dumps([asdict(self), data, programs, sources], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def estimator(self, name: str, seed: int, shape: tuple[int, ...] | None = None) -> Any:
        """Make a new estimator and set its seeds.

        Args:
            name: The name of a built-in estimator, or ``module:name`` of a user's estimator.
            seed: The seed. A user's estimator receives it in each parameter ``random_state``.
            shape: The shape of a frame, or of a series, before it became a row; None if rows are principal components.
                A user's estimator receives it in each parameter ``frame_shape``.

        Raises:
            InputError: ``module:name`` cannot be loaded or is not an estimator.
        """
        if name == "forest":
            from sklearn.ensemble import RandomForestClassifier

            return RandomForestClassifier(max_depth=self.depth, random_state=seed)
        if name == "network":
            from sklearn.neural_network import MLPClassifier

            # The notebooks' network has two hidden layers and no weight penalty.
            published = self.protocol == "as-published"
            more = {"hidden_layer_sizes": (HIDDEN, HIDDEN), "alpha": 0.0} if published else {}
            epochs = {"max_iter": self.epochs, "n_iter_no_change": self.epochs, "tol": 0.0}
            how = {"hidden_layer_sizes": (HIDDEN,), "batch_size": self.batch_size, **epochs, **more}
            return MLPClassifier(**how, random_state=seed)
        return _own(name, {"random_state": seed, "frame_shape": shape})


def shown_protocol(protocol: str, unknown_groups: Sequence[str]) -> str:
    """Return the name of a protocol for readers. It is not called leak-free if similar frames may be on both sides."""
    return "hold-out" if protocol == "leak-free" and unknown_groups else protocol


@dataclass(frozen=True, kw_only=True)
class ClassificationRecord(ClassificationSettings):
    """The settings and the data of a finished classification; the fields are the keys of its file.

    Reports and comparisons read this file.

    Args:
        analysis: The kind of analysis.
        version: The version of this program.
        trials: The number of trials.
        textures: The names of the textures, sorted.
        sensor: The name of the sensor.
        units: The unit of the numbers that were classified.
        summary: What these numbers are, for texts.
        simulated: The simulated parts of the data.
        data: The key of the data, see :attr:`~tacbench_cad.lab.analysis.collection.Collection.data_key`.
        unknown_groups: See :attr:`~tacbench_cad.lab.analysis.collection.Collection.unknown_groups`.
        notes: Remarks that a reader must know.
    """

    analysis: Literal["classification"] = "classification"
    version: str = __version__
    trials: int
    textures: Annotated[tuple[str, ...], Len(2)]
    sensor: str
    units: str
    summary: str = Feature.summary
    simulated: tuple[str, ...]
    data: str
    unknown_groups: tuple[str, ...] = ()
    notes: tuple[str, ...]

    @classmethod
    def read(cls, folder: Path) -> ClassificationRecord:
        """Read the record from an output folder of ``tacbench classify``.

        Raises:
            InputError: The file is missing or damaged.
        """
        return read_json(folder / SETTINGS_FILE, cls, "settings")

    def write(self, folder: Path) -> Path:
        """Write the record into a folder.

        Raises:
            InputError: The file cannot be written.
        """
        return write_settings(folder / SETTINGS_FILE, self)


def usual(
    protocol: Protocol,
    estimators: tuple[str, ...],
    *,
    image: bool = True,
    readings: int | None = None,
    few: bool = False,
) -> dict[str, Any]:
    """Return the default settings of a protocol, as arguments of :class:`ClassificationSettings`.

    Args:
        protocol: The protocol.
        estimators: The estimators.
        image: Whether the frames are images.
        readings: The number of frames, if known. The leak-free protocol then uses at most a quarter of this number of
            principal components, so that even its smallest training sets have enough rows.
        few: Whether a press has few numbers, such as the forces of a series. The leak-free protocol then takes them
            all, without principal components.
    """
    copies = PAPER_COPIES if image and protocol != "leak-free" else Augmentation()
    values: dict[str, Any] = {"protocol": protocol, "estimators": estimators, "augmentation": copies}
    if protocol == "as-published":
        return {**values, "augmentation": replace(copies, brightness=()), **SAVED.get(estimators[0], {})}
    if protocol == "leak-free" and (few or any(is_plugin(name) for name in estimators)):
        values["components"] = None
    elif protocol == "leak-free" and readings is not None:
        values["components"] = max(1, min(ClassificationSettings.components or 1, readings // 4))
    return values


def _own(name: str, values: Mapping[str, Any]) -> Any:
    """Make a user's estimator from an object, or from a class or function that is called without arguments.

    Args:
        name: ``module:name``.
        values: The values of parameters by name. Each value that is not None is set wherever the estimator, or a part
            of it, has this parameter.
    """
    from sklearn.base import clone

    source = _loaded(name)
    try:
        model = source() if inspect.isclass(source) or not hasattr(source, "fit") else clone(source)
        known = {key: values.get(key.rpartition("__")[2]) for key in model.get_params()}
        model.set_params(**{key: value for key, value in known.items() if value is not None})
    except TacbenchError:
        raise
    except Exception as error:
        what = f"{type(error).__name__}: {error}".splitlines()[0]
        raise InputError("estimator", name, f"must be a scikit-learn estimator, or make one: {what}") from error
    for needed in ("fit", "predict"):
        if not callable(getattr(model, needed, None)):
            raise InputError(
                "estimator", name, f"must make an estimator, but makes a {type(model).__name__}, which has no {needed}"
            )
    return model


def _loaded(name: str) -> Any:
    try:
        return load(name)
    except InputError as error:
        raise InputError("estimator", error.value, error.allowed) from error


def _source(name: str) -> str:
    """Return the SHA-256 of the file of a user's estimator, and of the files that its module lists as ``FILES``.

    If one of these files changes, trials are computed again.
    """
    source = _loaded(name)
    module = inspect.getmodule(source if inspect.isclass(source) or inspect.isfunction(source) else type(source))
    modules = [sys.modules.get(module) for module in (name.partition(":")[0], module.__name__ if module else "")]
    files = {getattr(module, "__file__", None) for module in modules}
    files |= {str(path) for module in modules for path in getattr(module, "FILES", ())}
    sources = (read_bytes(Path(path), "estimator") for path in sorted(filter(None, files)))
    return " ".join(hashlib.sha256(source).hexdigest() for source in sources)


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute matrix products on one thread, so that rounding does not depend on the number of cores."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1):
        yield

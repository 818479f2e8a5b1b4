"""What decides every number of a classification, and the estimators by name."""

from __future__ import annotations

import hashlib
import inspect
import json
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from tacbench_cad import __version__
from tacbench_cad.lab.analysis.classification.augment import Augmentation
from tacbench_cad.lab.analysis.classification.splits import FOLDS, HOLD_OUT_LEVELS, UNITS
from tacbench_cad.lab.analysis.tables import read_settings, write_settings
from tacbench_cad.lab.rig.plugin import is_plugin, load
from tacbench_cad.util.convert import Bounds, Length, check_fields
from tacbench_cad.util.door import read_bytes
from tacbench_cad.util.errors import InputError, TacbenchError, nearest, one_of

#: Estimators of our own: the paper's two.
ESTIMATORS = ("forest", "network")
#: Units in the hidden layer of the network.
HIDDEN = 50
#: Version of what computes a trial. Raise it with every change that gives other numbers for the same settings and data:
#: trials that an older version kept are then computed again.
ALGORITHM = 1
#: What was asked for, beside the tables.
SETTINGS_FILE = "classification_settings.json"
#: What classifies, by name.
Protocol = Literal["leak-free", "paper", "as-published"]
#: What the saved cells of the authors' notebooks took for each estimator, beside one noisy copy of each image.
SAVED: Mapping[str, Mapping[str, Any]] = {
    "forest": {"components": 25},
    "network": {"components": 45, "epochs": 15_000, "batch_size": 64},
}


@dataclass(frozen=True, kw_only=True)
class ClassificationSettings:
    """A classification; together with the data it decides every number.

    Args:
        protocol: ``leak-free`` keeps all of the test set out of training, ``paper`` does as the paper's text says,
            ``as-published`` as the notebooks' cells that gave the printed accuracies.
        estimators: ``forest``, ``network`` or ``module:name``.
        resolution: Fraction of an image's width and height that is kept.
        components: Principal components that the estimators get; None: the readings themselves.
        augmentation: Copies of training readings.
        clip: Round and clip the copies to whole counts of 0 to 255, as image tools save them (``paper`` only).
        seed: Everything random follows from it and the trial's number.
        hold_out: Hold-out levels (``leak-free`` only).
        folds: Folds of presses and of positions (``leak-free`` only).
        copies: Prints of each texture and combination in training; None: all (``leak-free`` only).
        epochs: Epochs of the network.
        batch_size: Rows of a step of the network.
        depth: Largest depth of the forest's trees.
        train_on: Combinations that are trained on, one at a time (not ``leak-free``).
        features: The numbers of a reading, or how far the markers in its image moved.
        roi: Region of interest, as ``--roi`` takes it; None for what is kept with the runs.
        marker_sigma: Width of a marker divided by 2.8, in pixels; None: estimated.
        marker_threshold: The least contrast of a marker, in counts; None: estimated.

    Raises:
        InputError: A value is not allowed.
    """

    protocol: Protocol = "leak-free"
    estimators: tuple[str, ...] = ("forest",)
    resolution: float = 0.4
    components: Annotated[int, Bounds(1)] | None = 25
    augmentation: Augmentation = field(default_factory=Augmentation)
    clip: bool = False
    seed: Annotated[int, Bounds(0)] = 0
    hold_out: tuple[str, ...] = HOLD_OUT_LEVELS
    folds: Annotated[int, Bounds(2)] = FOLDS
    copies: Annotated[int, Bounds(1)] | None = None
    epochs: Annotated[int, Bounds(1)] = 1500
    batch_size: Annotated[int, Bounds(1)] = 200
    depth: Annotated[int, Bounds(1)] = 50
    train_on: tuple[str, ...] = ()
    features: Literal["pixels", "markers"] = "pixels"
    roi: str | None = None
    marker_sigma: float | None = None
    marker_threshold: float | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        for name in self.estimators:
            if not is_plugin(name) and name not in ESTIMATORS:
                hint = nearest(name, ESTIMATORS)
                raise InputError("estimator", name, f"must be forest, network or module:name; {hint}")
        if not self.estimators or len(set(self.estimators)) < len(self.estimators):
            raise InputError("estimator", list(self.estimators), "must be names, each once")
        for level in self.hold_out:
            one_of("hold-out", level, UNITS)
        if self.protocol != "leak-free" and self.components is None:
            raise InputError("components", "none", "the paper's protocol has principal components; 25 of them")
        if self.clip and self.protocol != "paper":
            raise InputError("clip", True, "is for --protocol paper only; the others leave their copies unclipped")
        if self.protocol == "as-published" and (self.features != "pixels" or self.roi is not None):
            raise InputError(
                "protocol", self.protocol, "has the pixels of whole images; leave out --features and --roi"
            )
        if self.protocol == "as-published" and len(self.estimators) > 1:
            what = "must be one: the saved cells have other settings for each; classify twice"
            raise InputError("estimator", ",".join(self.estimators), what)

    def key(self, data: str) -> str:
        """Names the numbers that follow from these settings, from the data and from the programs that compute them.

        Args:
            data: Names the data, see :attr:`~tacbench_cad.lab.analysis.collection.Collection.data_key`.
        """
        import sklearn

        programs = [ALGORITHM, __version__, np.__version__, sklearn.__version__]
        sources = [_source(name) for name in self.estimators if is_plugin(name)]
        text = json.dumps([asdict(self), data, programs, sources], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def estimator(self, name: str, seed: int, shape: tuple[int, ...] | None = None) -> Any:
        """A new estimator with its seeds set.

        Args:
            name: One of ours, or ``module:name`` of your own.
            seed: The seed, for each parameter ``random_state`` of your own.
            shape: Shape of a reading before it became a row, for each parameter ``frame_shape`` of your own; None
                where rows are something else, principal components.

        Raises:
            InputError: ``module:name`` cannot be loaded or is no estimator.
        """
        if name == "forest":
            from sklearn.ensemble import RandomForestClassifier

            return RandomForestClassifier(max_depth=self.depth, random_state=seed)
        if name == "network" and self.protocol == "as-published":
            from sklearn.neural_network import MLPClassifier

            # Two hidden layers, all epochs, no weight penalty. The first weights are scikit-learn's, not PyTorch's.
            epochs = {"max_iter": self.epochs, "n_iter_no_change": self.epochs, "tol": 0.0}
            layers = (HIDDEN, HIDDEN)
            return MLPClassifier(layers, batch_size=self.batch_size, alpha=0.0, random_state=seed, **epochs)
        if name == "network":
            from tacbench_cad.lab.analysis.classification.network import NetworkClassifier

            return NetworkClassifier((HIDDEN,), max_iter=self.epochs, batch_size=self.batch_size, random_state=seed)
        return _own(name, {"random_state": seed, "frame_shape": shape})


@dataclass(frozen=True, kw_only=True)
class ClassificationRecord(ClassificationSettings):
    """What was asked for and of which data. Reports and comparisons read it; its fields are the keys of its file.

    Args:
        analysis: What the file is of.
        version: Of this program.
        trials: Trials.
        textures: The textures, sorted.
        sensor: Name of the sensor.
        units: Unit of the readings.
        simulated: What of the data was simulated.
        data: Names the data, see :attr:`~tacbench_cad.lab.analysis.collection.Collection.data_key`.
        notes: What a reader must know.
    """

    analysis: Literal["classification"] = "classification"
    version: str = __version__
    trials: int
    textures: Annotated[tuple[str, ...], Length(2)]
    sensor: str
    units: str
    simulated: tuple[str, ...]
    data: str
    notes: tuple[str, ...]

    @classmethod
    def read(cls, folder: Path) -> ClassificationRecord:
        """That of a folder that ``tacbench classify`` wrote.

        Raises:
            InputError: It is missing or damaged.
        """
        return read_settings(folder / SETTINGS_FILE, cls)

    def write(self, folder: Path) -> Path:
        """Write it into a folder.

        Raises:
            InputError: It cannot be written.
        """
        return write_settings(folder / SETTINGS_FILE, self)


def usual(
    protocol: Protocol, estimators: tuple[str, ...], *, image: bool = True, readings: int | None = None
) -> dict[str, Any]:
    """What a protocol takes where nothing else is said, as arguments of :class:`ClassificationSettings`.

    Args:
        protocol: The protocol.
        estimators: The estimators.
        image: Whether the readings are images.
        readings: How many there are, where that matters: the leak-free protocol takes no more principal components than
            a quarter of them, which even its smallest training sets have.
    """
    copies = Augmentation() if image else Augmentation(noise=None, brightness=())
    values: dict[str, Any] = {"protocol": protocol, "estimators": estimators, "augmentation": copies}
    if protocol == "as-published":
        return {**values, "augmentation": replace(copies, brightness=()), **SAVED.get(estimators[0], {})}
    if protocol == "leak-free" and any(is_plugin(name) for name in estimators):
        values["components"] = None
    elif protocol == "leak-free" and readings is not None:
        values["components"] = max(1, min(ClassificationSettings.components or 1, readings // 4))
    return values


def _own(name: str, values: Mapping[str, Any]) -> Any:
    """A user's estimator: an object, or a class or function that makes one when it is called with nothing.

    Args:
        name: ``module:name``.
        values: Of parameters, by name. Each that is not None is set wherever the estimator or a part of it has it.
    """
    from sklearn.base import clone

    thing = _loaded(name)
    try:
        model = thing() if inspect.isclass(thing) or not hasattr(thing, "fit") else clone(thing)
        known = {key: values.get(key.rpartition("__")[2]) for key in model.get_params()}
        model.set_params(**{key: value for key, value in known.items() if value is not None})
    except TacbenchError:
        raise
    except Exception as error:
        what = f"{type(error).__name__}: {error}".splitlines()[0]
        raise InputError("estimator", name, f"is no scikit-learn estimator and makes none: {what}") from error
    for needed in ("fit", "predict"):
        if not callable(getattr(model, needed, None)):
            raise InputError("estimator", name, f"gives a {type(model).__name__}, which has no {needed}")
    return model


def _loaded(name: str) -> Any:
    try:
        return load(name)
    except InputError as error:
        raise InputError("estimator", error.value, error.allowed) from error


def _source(name: str) -> str:
    """The SHA-256 of the file that a user's estimator comes from, and of those that its module lists as ``FILES``.

    A trial is computed again after any of them has changed.
    """
    thing = _loaded(name)
    module = inspect.getmodule(thing if inspect.isclass(thing) or inspect.isfunction(thing) else type(thing))
    modules = [sys.modules.get(module) for module in (name.partition(":")[0], module.__name__ if module else "")]
    files = {getattr(module, "__file__", None) for module in modules}
    files |= {str(path) for module in modules for path in getattr(module, "FILES", ())}
    sources = (read_bytes(Path(path), "estimator") for path in sorted(filter(None, files)))
    return " ".join(hashlib.sha256(source).hexdigest() for source in sources)


@contextmanager
def one_thread() -> Iterator[None]:
    """Matrix products on one thread: their rounding must not depend on the machine, and processes share its cores."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1):
        yield

"""What decides every number of a classification, and the estimators by name."""

from __future__ import annotations

import hashlib
import inspect
import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad import __version__
from tacbench_cad.lab.analysis.classification.augment import Augmentation
from tacbench_cad.lab.analysis.classification.splits import FOLDS, HOLD_OUT_LEVELS
from tacbench_cad.lab.rig.plugin import is_plugin, load
from tacbench_cad.util.door import read_bytes
from tacbench_cad.util.errors import InputError, TacbenchError, nearest, one_of

#: The protocols: ``leak-free`` keeps all of the test set out of training, ``paper`` does as the paper's text says.
PROTOCOLS = ("leak-free", "paper")
#: Estimators of our own: the paper's two.
ESTIMATORS = ("forest", "network")
#: Units in the hidden layer of the network.
HIDDEN = 50
#: Version of what computes a trial. Raise it with every change that gives other numbers for the same settings and data:
#: trials that an older version kept are then computed again.
ALGORITHM = 1
#: Fraction of the augmented rows that the paper's protocol holds back.
TEST_FRACTION = 0.2


@dataclass(frozen=True, kw_only=True)
class ClassificationSettings:
    """A classification; together with the data it decides every number.

    Args:
        protocol: ``leak-free`` or ``paper``.
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
        train_on: Combinations that are trained on, one at a time (``paper`` only).

    Raises:
        InputError: A value is not allowed.
    """

    protocol: str = "leak-free"
    estimators: tuple[str, ...] = ("forest",)
    resolution: float = 0.4
    components: int | None = 25
    augmentation: Augmentation = field(default_factory=Augmentation)
    clip: bool = False
    seed: int = 0
    hold_out: tuple[str, ...] = HOLD_OUT_LEVELS
    folds: int = FOLDS
    copies: int | None = None
    epochs: int = 1500
    batch_size: int = 200
    depth: int = 50
    train_on: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        one_of("protocol", self.protocol, PROTOCOLS)
        for name in self.estimators:
            if not is_plugin(name) and name not in ESTIMATORS:
                hint = nearest(name, ESTIMATORS)
                raise InputError("estimator", name, f"must be forest, network or module:name; {hint}")
        if not self.estimators or len(set(self.estimators)) < len(self.estimators):
            raise InputError("estimator", list(self.estimators), "must be names, each once")
        for level in self.hold_out:
            one_of("hold-out", level, HOLD_OUT_LEVELS)
        for key, value, least in (
            ("components", self.components, 1),
            ("seed", self.seed, 0),
            ("folds", self.folds, 2),
            ("copies", self.copies, 1),
            ("epochs", self.epochs, 1),
            ("batch-size", self.batch_size, 1),
            ("depth", self.depth, 1),
        ):
            if value is not None and value < least:
                raise InputError(key, value, f"must be at least {least}")
        if self.protocol == "paper" and self.components is None:
            raise InputError("components", "none", "the paper's protocol has principal components; 25 of them")
        if self.clip and self.protocol == "leak-free":
            raise InputError("clip", True, "is the paper's protocol only; leak-free leaves its copies unclipped")

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

    def estimator(self, name: str, seed: int) -> Any:
        """A new estimator with its seeds set.

        Args:
            name: One of ours, or ``module:name`` of your own.
            seed: The seed.

        Raises:
            InputError: ``module:name`` cannot be loaded or is no estimator.
        """
        if name == "forest":
            from sklearn.ensemble import RandomForestClassifier

            return RandomForestClassifier(max_depth=self.depth, random_state=seed)
        if name == "network":
            from tacbench_cad.lab.analysis.classification.network import NetworkClassifier

            return NetworkClassifier((HIDDEN,), max_iter=self.epochs, batch_size=self.batch_size, random_state=seed)
        return _own(name, seed)


def _own(name: str, seed: int) -> Any:
    """A user's estimator: an object, or a class or function that makes one when it is called with nothing."""
    from sklearn.base import clone

    thing = _loaded(name)
    try:
        model = thing() if inspect.isclass(thing) or not hasattr(thing, "fit") else clone(thing)
        seeds = [key for key in model.get_params() if key == "random_state" or key.endswith("__random_state")]
        model.set_params(**dict.fromkeys(seeds, seed))
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
    """The SHA-256 of the file that a user's estimator comes from, so that a changed one is computed anew."""
    thing = _loaded(name)
    module = inspect.getmodule(thing if inspect.isclass(thing) or inspect.isfunction(thing) else type(thing))
    modules = (name.partition(":")[0], module.__name__ if module else "")
    files = {getattr(sys.modules.get(module), "__file__", None) for module in modules}
    sources = (read_bytes(Path(path), "estimator") for path in sorted(filter(None, files)))
    return " ".join(hashlib.sha256(source).hexdigest() for source in sources)


@contextmanager
def one_thread() -> Iterator[None]:
    """Matrix products on one thread: their rounding must not depend on the machine, and processes share its cores."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1):
        yield

"""The settings of a classification, and the estimators by name."""

from __future__ import annotations

import hashlib
import inspect
import sys
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge
from numpy.typing import NDArray
from sklearn.base import clone
from sklearn.ensemble import RandomForestClassifier
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPClassifier
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from tacbench_cad.lab.analysis import published
from tacbench_cad.lab.analysis.classification.hold_out import FOLDS, UNITS
from tacbench_cad.lab.analysis.classification.training_rows import PAPER_COPIES, Augmentation
from tacbench_cad.lab.analysis.feature import Feature
from tacbench_cad.lab.analysis.study_design import Design
from tacbench_cad.lab.rig.plugin import is_plugin, load
from tacbench_cad.lab.rig.sensor import is_image
from tacbench_cad.lab.runs.press_table import read_frame
from tacbench_cad.util.convert import check_fields
from tacbench_cad.util.errors import InputError, TacbenchError, nearest, one_of
from tacbench_cad.util.untrusted import read_bytes

#: The built-in estimators: the paper's two.
ESTIMATORS = ("forest", "network")
#: The number of neurons in a hidden layer of the network.
HIDDEN = 50
#: The names of the protocols, each with the default number of trials. The leak-free trials of a level without random
#: folds differ in the seed of the estimator only, so one is enough. The paper's number is that of its text.
TRIALS = {"leak-free": 1, "paper": published.TRIALS, "as-published": published.TRIALS}
Protocol = Literal["leak-free", "paper", "as-published"]
#: The settings of each estimator in the saved cells of the authors' notebooks. They also use one noisy copy of each
#: image.
SAVED: Mapping[str, Mapping[str, Any]] = {
    "forest": {"components": 25},
    "network": {"components": 45, "epochs": 15_000, "batch_size": 64},
}


@dataclass(frozen=True, kw_only=True)
class ClassificationSettings:
    """The settings of a classification. Together with the data and the feature they determine all results.

    Args:
        protocol: ``leak-free`` keeps the test set completely out of training. ``paper`` follows the paper's text, and
            ``as-published`` the notebooks' cells that computed the printed accuracies.
        estimators: ``forest``, ``network`` or ``module:name``.
        components: The number of principal components that the estimators receive; None for the frames themselves.
        augmentation: The copies that are added to training frames. The paper's protocols need
            :data:`~tacbench_cad.lab.analysis.classification.training_rows.PAPER_COPIES`, which
            :func:`default_settings` returns.
        clip: Round and clip the copies to whole counts from 0 to 255, as in image files (``paper`` only).
        seed: The seed. All random numbers follow from it and the number of the trial.
        hold_out: The hold-out levels (``leak-free`` only); empty for all that the data support.
        folds: The number of folds of presses and of positions (``leak-free`` only).
        copies: The number of prints of each texture and combination in training; None for all (``leak-free`` only).
        epochs: The number of epochs of the network.
        batch_size: The number of rows in a step of the network.
        depth: The maximum depth of the forest's trees.
        train_on: The training combinations, used one at a time (not ``leak-free``); empty for those of the paper that
            the data have, or all if there is none.

    Raises:
        InputError: A value is not allowed.
    """

    protocol: Protocol = "leak-free"
    estimators: tuple[str, ...] = ("forest",)
    components: Annotated[int, Ge(1)] | None = 25
    augmentation: Augmentation = field(default_factory=Augmentation)
    clip: bool = False
    seed: Annotated[int, Ge(0)] = 0
    hold_out: tuple[str, ...] = ()
    folds: Annotated[int, Ge(2)] = FOLDS
    copies: Annotated[int, Ge(1)] | None = None
    epochs: Annotated[int, Ge(1)] = 1500
    batch_size: Annotated[int, Ge(1)] = 200
    depth: Annotated[int, Ge(1)] = 50
    train_on: tuple[str, ...] = ()

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
        if self.protocol == "as-published" and len(self.estimators) > 1:
            what = "must be a single name, because the saved cells have other settings for each; classify twice"
            raise InputError("estimator", ",".join(self.estimators), what)

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
            return RandomForestClassifier(max_depth=self.depth, random_state=seed)
        if name == "network":
            # The notebooks' network has two hidden layers and no weight penalty.
            how = {"hidden_layer_sizes": (HIDDEN, HIDDEN), "alpha": 0.0} if self.protocol == "as-published" else {}
            how |= {"max_iter": self.epochs, "n_iter_no_change": self.epochs, "tol": 0.0, "random_state": seed}
            return MLPClassifier(**{"hidden_layer_sizes": (HIDDEN,), "batch_size": self.batch_size, **how})
        return _own(name, {"random_state": seed, "frame_shape": shape})

    @property
    def sources(self) -> list[str]:
        """The SHA-256 of the file of each user's estimator, and of the files that its module lists as ``FILES``.

        If one of these files changes, stored trials are computed again.
        """
        files: list[str] = []
        for name in filter(is_plugin, self.estimators):
            source = load(name, field="estimator")
            kind = source if inspect.isclass(source) or inspect.isfunction(source) else type(source)
            for module in (sys.modules.get(name.partition(":")[0]), sys.modules.get(kind.__module__)):
                files += [getattr(module, "__file__", None) or "", *map(str, getattr(module, "FILES", ()))]
        return [hashlib.sha256(read_bytes(Path(file), "estimator")).hexdigest() for file in filter(None, files)]


def default_settings(
    design: Design,
    feature: Feature,
    protocol: Protocol = "leak-free",
    estimators: tuple[str, ...] = (),
    **given: Any,
) -> ClassificationSettings:
    """Return the usual settings for some data.

    The leak-free protocol uses at most a quarter of the number of presses as principal components, so that even its
    smallest training sets have enough rows; and none for own estimators and for features with few numbers.

    Args:
        design: The design of the study.
        feature: The feature that is classified.
        protocol: The protocol.
        estimators: The estimators; by default the forest, and for ``paper`` both.
        given: Other values of fields of the settings, or of its augmentation.

    Raises:
        InputError: A value is not allowed.
        CheckFailedError: The first frame cannot be read.
    """
    estimators = estimators or (ESTIMATORS if protocol == "paper" else ESTIMATORS[:1])
    values: dict[str, Any] = {"protocol": protocol, "estimators": estimators}
    image = feature.from_frames and feature.unit is None and is_image(read_frame(design.presses["frame"].iloc[0]))
    copies = PAPER_COPIES if image and protocol != "leak-free" else Augmentation()
    if protocol == "as-published":
        copies = replace(copies, brightness=())
        values |= SAVED.get(estimators[0], {})
    elif protocol == "leak-free" and (feature.few_numbers or any(map(is_plugin, estimators))):
        values["components"] = None
    elif protocol == "leak-free":
        values["components"] = max(1, min(ClassificationSettings.components or 1, len(design) // 4))
    of_copies = {name: given.pop(name) for name in ("noise", "brightness") if name in given}
    return ClassificationSettings(**{**values, "augmentation": replace(copies, **of_copies), **given})


def shown_protocol(protocol: str, unknown_groups: Sequence[str]) -> str:
    """Return the name of a protocol for readers. It is not called leak-free if similar frames may be on both sides."""
    return "hold-out" if protocol == "leak-free" and unknown_groups else protocol


def trial_seed(seed: int, trial: int) -> int:
    """Return the seed of all random numbers in one trial.

    Args:
        seed: The seed of the classification.
        trial: The number of the trial, from 1.
    """
    return int(np.random.SeedSequence([seed, trial]).generate_state(1)[0])


def predicted(
    name: str,
    model: Any,
    training: tuple[NDArray[Any], NDArray[Any]],
    tests: Sequence[NDArray[Any]],
    where: str,
    *,
    scale: bool = False,
) -> list[NDArray[Any]]:
    """Train an estimator, and return its predictions for several sets of rows.

    Args:
        name: Its name, for error messages.
        model: The estimator.
        training: The training rows and their textures.
        tests: The sets of rows.
        where: The trial and the fold, for error messages.
        scale: Whether the rows are scaled to the standard deviation 1 first.

    Raises:
        InputError: The estimator raises an error, or does not predict a texture of the training set for each row.
    """
    try:
        with warnings.catch_warnings():
            if name == "network":  # it runs all epochs, also on few rows
                warnings.simplefilter("ignore", ConvergenceWarning)
                warnings.filterwarnings("ignore", "Got `batch_size`")
            model = (make_pipeline(StandardScaler(), model) if scale else model).fit(*training)
            found = [np.asarray(model.predict(rows)) for rows in tests]
    except TacbenchError:
        raise
    except Exception as error:
        raise InputError("estimator", name, f"raised {_in_words(error)} in {where}") from error
    for words, rows in zip(found, tests, strict=True):
        if words.shape != (len(rows),) or not np.isin(words, training[1]).all():
            what = f"predicts {words.dtype} {words.shape} in {where}; must be one of the textures for each of "
            raise InputError("estimator", name, f"{what}{len(rows)} rows")
    return found


def _own(name: str, values: Mapping[str, Any]) -> Any:
    """Make a user's estimator from an object, or from a class or function that is called without arguments.

    Args:
        name: ``module:name``.
        values: The values of parameters by name. Each value that is not None is set wherever the estimator, or a part
            of it, has this parameter.
    """
    source = load(name, field="estimator")
    try:
        model = source() if inspect.isclass(source) or not hasattr(source, "fit") else clone(source)
        known = {key: values.get(key.rpartition("__")[2]) for key in model.get_params()}
        model.set_params(**{key: value for key, value in known.items() if value is not None})
        _ = model.fit, model.predict
    except TacbenchError:
        raise
    except Exception as error:
        what = f"must be a scikit-learn estimator, or make one: {_in_words(error)}"
        raise InputError("estimator", name, what) from error
    return model


def _in_words(error: Exception) -> str:
    """Return the kind of an exception and the first line of its message."""
    return f"{type(error).__name__}: {str(error).strip() or 'without a message'}".splitlines()[0]

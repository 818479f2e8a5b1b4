"""The paper's network, many at a time: scikit-learn's ``MLPClassifier`` with one hidden layer, without its overhead.

A batch of 200 rows of 25 numbers is so little work that ``MLPClassifier`` spends most of an epoch between its
operations. Here the weights of several networks lie in one array, each step of a batch is one NumPy call for all of
them, and all buffers are made once. Initial weights, shuffles, loss, gradients and Adam's steps are those of
``MLPClassifier`` (Kingma and Ba, 2014, with the weight penalty in the gradient), in the same order of random numbers:
the same ``random_state`` gives the same loss curve up to rounding.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.utils import check_random_state
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import check_is_fitted, validate_data
from threadpoolctl import threadpool_limits

from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats, Floats32

Reals = Floats | Floats32

#: Adam's decay rates and the number that keeps its steps finite, as in ``MLPClassifier``.
BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8
#: Networks that are trained at once; measured: more gain nothing, and their weights leave the fast memory of one core.
TOGETHER = 8


class NetworkClassifier(ClassifierMixin, BaseEstimator):  # type: ignore[misc]
    """One hidden layer of rectified linear units, softmax, cross entropy and Adam, for all epochs.

    It is ``MLPClassifier(hidden_layer_sizes=(hidden,), n_iter_no_change=max_iter, tol=0)`` with the same other
    parameters: same initial weights, same shuffles, loss curve equal up to rounding. Numbers given as float32 are
    computed with as float32, the rest as float64. A network with rows of about zero mean and unit spread learns best;
    nothing is scaled here.

    Args:
        hidden: Units in the hidden layer.
        alpha: Weight of the squared weights in the loss, divided by the batch's rows.
        batch_size: Rows a step; fewer if there are fewer.
        learning_rate_init: Adam's step.
        max_iter: Epochs; all are run.
        shuffle: Draw the order of the rows anew for each epoch.
        random_state: Seed of the initial weights and of the shuffles.

    Attributes:
        classes_: The labels, sorted, (k,).
        coefs_: Weights, (features, hidden) and (hidden, outputs); one output for two classes, else k.
        intercepts_: (hidden,) and (outputs,).
        loss_curve_: Mean loss of each epoch.
    """

    def __init__(
        self,
        hidden: int = 50,
        *,
        alpha: float = 1e-4,
        batch_size: int = 200,
        learning_rate_init: float = 1e-3,
        max_iter: int = 1500,
        shuffle: bool = True,
        random_state: int | np.random.RandomState | None = None,
    ) -> None:
        self.hidden = hidden
        self.alpha = alpha
        self.batch_size = batch_size
        self.learning_rate_init = learning_rate_init
        self.max_iter = max_iter
        self.shuffle = shuffle
        self.random_state = random_state

    def fit(self, X: ArrayLike, y: ArrayLike) -> NetworkClassifier:  # noqa: N803
        """Train.

        Args:
            X: Rows, (n, features).
            y: Their labels, (n,).

        Returns:
            The network itself.
        """
        return fit_together([self], [(X, y)])[0]

    def predict_proba(self, X: ArrayLike) -> Reals:  # noqa: N803
        """Probability of each class for each row, (n, k)."""
        check_is_fitted(self)
        rows = validate_data(self, X, dtype=(np.float64, np.float32), reset=False)
        hidden = np.maximum(rows @ self.coefs_[0] + self.intercepts_[0], 0)
        out = (hidden @ self.coefs_[1] + self.intercepts_[1]).T
        probabilities = np.empty_like(out)
        _squash(out, probabilities)
        if len(probabilities) == 1:
            probabilities = np.concatenate([1 - probabilities, probabilities])
        return cast(Reals, np.ascontiguousarray(probabilities.T))

    def predict(self, X: ArrayLike) -> NDArray[Any]:  # noqa: N803
        """The most probable label of each row, (n,)."""
        best = np.argmax(self.predict_proba(X), axis=1)
        return cast(NDArray[Any], self.classes_[best])


def fit_together(
    networks: Sequence[NetworkClassifier], data: Sequence[tuple[ArrayLike, ArrayLike]]
) -> list[NetworkClassifier]:
    """Train each network on its own rows and labels, several at once; the result is that of one ``fit`` after another.

    Networks of equal parameters on sets of equal size run together, at most :data:`TOGETHER`; it uses one core, so give
    each of several processes its share.

    Args:
        networks: The networks, whose seeds are their own.
        data: Rows (n, features) and labels (n,) of each.

    Returns:
        The same networks, fitted.

    Raises:
        InputError: There are not as many sets as networks, or a parameter is not allowed.
        ValueError: As scikit-learn's estimators: bad shapes or labels, NaN, or weights that overflow.
    """
    if len(networks) != len(data):
        raise InputError("data", len(data), f"must be one set for each of {len(networks)} networks")
    with threadpool_limits(limits=1):  # matrices this small only lose by threads
        groups: dict[tuple[object, ...], list[_Task]] = {}
        for network, (rows, labels) in zip(networks, data, strict=True):
            task = _task(network, rows, labels)
            groups.setdefault(task.key, []).append(task)
        for tasks in groups.values():
            for first in range(0, len(tasks), TOGETHER):
                _train(tasks[first : first + TOGETHER])
    return list(networks)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Task:
    """A network with its checked data.

    Args:
        rows: (n, features + 1); the last column is 1, for the hidden layer's intercepts.
        targets: 1 where a row has an output's class, else 0, (outputs, n).
    """

    network: NetworkClassifier
    rows: Reals
    targets: Reals

    @property
    def key(self) -> tuple[object, ...]:
        """What must be equal for networks to be trained together."""
        one = self.network
        settings = (one.hidden, one.alpha, one.batch_size, one.learning_rate_init, one.max_iter, one.shuffle)
        return (*settings, self.rows.shape, self.targets.shape, self.rows.dtype)


def _require_allowed(network: NetworkClassifier) -> None:
    """Check the parameters.

    Raises:
        InputError: One is not allowed.
    """
    for name in ("hidden", "batch_size", "max_iter"):
        value = getattr(network, name)
        if isinstance(value, bool) or not isinstance(value, Integral) or value < 1:
            raise InputError(name, value, "must be a whole number of at least 1")
    for name, least in (("alpha", 0.0), ("learning_rate_init", np.nextafter(0.0, 1.0))):
        value = getattr(network, name)
        if not isinstance(value, Real) or not least <= float(value) < np.inf:
            raise InputError(name, value, f"must be a finite number {'above' if least else 'of at least'} 0")


def _task(network: NetworkClassifier, rows: ArrayLike, labels: ArrayLike) -> _Task:
    _require_allowed(network)
    values, names = validate_data(network, rows, labels, dtype=(np.float64, np.float32))
    check_classification_targets(names)
    network.classes_, index = np.unique(names, return_inverse=True)
    count = len(network.classes_)
    if count < 2:
        raise ValueError(f"The labels have {count} class; a classifier needs at least 2 classes.")
    wanted = [1] if count == 2 else list(range(count))
    targets = np.stack([index == one for one in wanted]).astype(values.dtype)
    ones = np.ones((len(values), 1), dtype=values.dtype)
    return _Task(network=network, rows=np.concatenate([values, ones], axis=1), targets=targets)


def _squash(out: Reals, probabilities: Reals) -> None:
    """Softmax over the second last axis, in place of ``out``; the logistic function where there is one output."""
    if out.shape[-2] == 1:
        expit(out, out=probabilities)
        return
    np.subtract(out, out.max(axis=-2, keepdims=True), out=out)
    np.exp(out, out=out)
    np.divide(out, out.sum(axis=-2, keepdims=True), out=probabilities)


class _Layers:
    """Numbers of all weights of t networks in one array (t, size), seen as two layers with their intercepts last.

    Args:
        flat: hidden x (features + 1) numbers, then outputs x (hidden + 1).
        features: Columns of the rows, without the column of ones.
        hidden: Units of the hidden layer.
        outputs: Outputs.
    """

    def __init__(self, flat: Reals, features: int, hidden: int, outputs: int) -> None:
        self.flat = flat
        cut = hidden * (features + 1)
        self.first = flat[:, :cut].reshape(len(flat), hidden, features + 1)
        self.last = flat[:, cut:].reshape(len(flat), outputs, hidden + 1)


class _Buffers:
    """Space for one batch of m rows of t networks; one column a row."""

    def __init__(self, t: int, m: int, width: int, hidden: int, outputs: int, dtype: np.dtype[Any]) -> None:
        self.rows = np.empty((t, m, width), dtype)
        self.hidden = np.ones((t, hidden + 1, m), dtype)  # the last line stays 1, for the intercepts
        self.out = np.empty((t, outputs, m), dtype)
        self.back = np.empty((t, hidden, m), dtype)


def _initial(task: _Task, state: np.random.RandomState, layers: _Layers, index: int) -> None:
    """Draw the initial weights as ``MLPClassifier`` does: Glorot's bound for rectified units, layer after layer."""
    features, hidden, outputs = task.rows.shape[1] - 1, task.network.hidden, len(task.targets)
    for weights, fan_in, fan_out in ((layers.first, features, hidden), (layers.last, hidden, outputs)):
        bound = np.sqrt(6.0 / (fan_in + fan_out))
        weights[index, :, :-1] = state.uniform(-bound, bound, (fan_in, fan_out)).T
        weights[index, :, -1] = state.uniform(-bound, bound, fan_out)


def _batches(count: int, size: int) -> Iterator[slice]:
    for first in range(0, count, size):
        yield slice(first, min(first + size, count))


def _train(tasks: Sequence[_Task]) -> None:
    """Train networks of equal key at once and set their attributes."""
    one = tasks[0].network
    (count, width), outputs, dtype = tasks[0].rows.shape, len(tasks[0].targets), tasks[0].rows.dtype
    shape = (len(tasks), one.hidden * width + outputs * (one.hidden + 1))
    layers = _Layers(np.empty(shape, dtype), width - 1, one.hidden, outputs)
    slopes = _Layers(np.empty(shape, dtype), width - 1, one.hidden, outputs)
    penalty = _Layers(np.full((1, shape[1]), one.alpha, dtype), width - 1, one.hidden, outputs)
    penalty.first[..., -1] = penalty.last[..., -1] = 0  # intercepts are free
    states = [check_random_state(task.network.random_state) for task in tasks]
    for index, (task, state) in enumerate(zip(tasks, states, strict=True)):
        _initial(task, state, layers, index)

    adam = _Adam(layers.flat, one.learning_rate_init)
    batches = list(_batches(count, min(one.batch_size, count)))
    spaces = {
        m: _Buffers(len(tasks), m, width, one.hidden, outputs, dtype) for m in {b.stop - b.start for b in batches}
    }
    order = [np.arange(count) for _ in tasks]
    targets = cast(Reals, np.stack([task.targets for task in tasks]))
    fitted = np.empty_like(targets)
    pull, shrunk = np.empty(shape, dtype), np.empty(len(tasks), dtype)
    curves = np.empty((one.max_iter, len(tasks)))
    for epoch in range(one.max_iter):
        if one.shuffle:
            for index, (task, state) in enumerate(zip(tasks, states, strict=True)):
                permutation = np.arange(count)
                state.shuffle(permutation)
                order[index] = order[index][permutation]
                np.take(task.targets, order[index], axis=1, out=targets[index], mode="clip")
        shrunk[:] = 0
        for batch in batches:
            size = batch.stop - batch.start
            space = spaces[size]
            for index, task in enumerate(tasks):
                task.rows.take(order[index][batch], axis=0, out=space.rows[index], mode="clip")
            _slopes(space, targets[..., batch], fitted[..., batch], layers, slopes)
            np.multiply(penalty.flat, layers.flat, out=pull)
            np.add(slopes.flat, pull, out=slopes.flat)
            np.divide(slopes.flat, size, out=slopes.flat)
            shrunk += np.vecdot(pull, layers.flat)
            adam.step(slopes.flat)
        curves[epoch] = (_surprise(fitted, targets) + 0.5 * shrunk) / count
    for index, task in enumerate(tasks):
        _finish(task, layers, index, curves[:, index])


def _slopes(space: _Buffers, targets: Reals, fitted: Reals, layers: _Layers, slopes: _Layers) -> None:
    """The sums over a batch of the cross entropy's derivatives, into ``slopes``; the probabilities into ``fitted``.

    Args:
        space: Holds the batch's rows; the rest is overwritten.
        targets: (t, outputs, m).
        fitted: Likewise; overwritten.
        layers: The networks.
        slopes: Likewise; overwritten.
    """
    hidden = space.hidden[:, :-1]
    np.matmul(layers.first, space.rows.swapaxes(1, 2), out=hidden)
    np.maximum(hidden, 0, out=hidden)
    np.matmul(layers.last, space.hidden, out=space.out)
    _squash(space.out, fitted)
    np.subtract(fitted, targets, out=space.out)
    np.matmul(space.out, space.hidden.swapaxes(1, 2), out=slopes.last)
    np.matmul(layers.last[..., :-1].swapaxes(1, 2), space.out, out=space.back)
    np.greater(hidden, 0, out=hidden)  # 1 or 0: the unit's own derivative
    np.multiply(space.back, hidden, out=space.back)
    np.matmul(space.back, space.rows, out=slopes.first)


def _surprise(fitted: Reals, targets: Reals) -> Reals:
    """Sum of -log of the true class's probability over an epoch's rows, clipped as scikit-learn does, (t,)."""
    least = np.finfo(fitted.dtype).eps
    if fitted.shape[1] == 1:
        true = np.where(targets[:, 0] == 1, fitted[:, 0], 1 - fitted[:, 0])
    else:
        true = np.einsum("tkn,tkn->tn", fitted, targets)
    return cast(Reals, -np.log(np.clip(true, least, 1 - least)).sum(axis=1))


class _Adam:
    """Adam's state for numbers that it changes in place.

    Args:
        values: The numbers, any shape.
        rate: The step.
    """

    def __init__(self, values: Reals, rate: float) -> None:
        self.values = values
        self.rate = rate
        self.steps = 0
        self.mean = np.zeros_like(values)
        self.square = np.zeros_like(values)
        self._space = np.empty_like(values)

    def step(self, slope: Reals) -> None:
        """One step against a slope, which is overwritten."""
        self.steps += 1
        space = self._space
        np.multiply(self.mean, BETA_1, out=self.mean)
        np.multiply(slope, 1 - BETA_1, out=space)
        np.add(self.mean, space, out=self.mean)
        np.multiply(slope, slope, out=slope)
        np.multiply(slope, 1 - BETA_2, out=slope)
        np.multiply(self.square, BETA_2, out=self.square)
        np.add(self.square, slope, out=self.square)
        rate = self.rate * float(np.sqrt(1 - BETA_2**self.steps)) / (1 - BETA_1**self.steps)
        np.sqrt(self.square, out=slope)
        np.add(slope, EPSILON, out=slope)
        np.multiply(self.mean, -rate, out=space)
        np.divide(space, slope, out=space)
        np.add(self.values, space, out=self.values)


def _finish(task: _Task, layers: _Layers, index: int, curve: Reals) -> None:
    """Set the attributes of a trained network.

    Raises:
        ValueError: Its weights are not finite, as scikit-learn says it.
    """
    if not np.isfinite(layers.flat[index]).all():
        raise ValueError("The network's weights are not finite; the rows' numbers may be too large: scale them.")
    network = task.network
    network.coefs_ = [layer[index, :, :-1].T.copy() for layer in (layers.first, layers.last)]
    network.intercepts_ = [layer[index, :, -1].copy() for layer in (layers.first, layers.last)]
    network.loss_curve_ = [float(value) for value in curve]
    network.loss_ = network.loss_curve_[-1]
    network.n_iter_ = network.max_iter
    network.n_outputs_ = len(task.targets)

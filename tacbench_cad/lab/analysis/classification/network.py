"""The paper's network: a faster version of scikit-learn's ``MLPClassifier`` that trains several networks together.

A batch of 200 rows with 25 numbers is so small that ``MLPClassifier`` spends most of an epoch on overhead between its
operations. Here the weights of several networks are in one array, each step of a batch is one NumPy call for all of
them, and all buffers are allocated once. Initial weights, shuffles, loss, gradients and Adam's steps are those of
``MLPClassifier`` (Kingma and Ba, 2014, with the weight penalty in the gradient), with random numbers in the same order.
Therefore the same ``random_state`` gives the same loss curve up to rounding. The paper's complete protocol takes a
third of the time of ``MLPClassifier``.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPClassifier
from sklearn.utils import check_random_state
from threadpoolctl import threadpool_limits

#: Arrays of float32 or float64: like MLPClassifier, this module computes with float32 if the rows are float32.
Numbers = NDArray[Any]

#: The number of networks that are trained together. More are not faster: their weights no longer fit into the cache.
TOGETHER = 8


class NetworkClassifier(MLPClassifier):  # type: ignore[misc]
    """``MLPClassifier`` for one hidden layer of rectified linear units and Adam, which runs all epochs, but faster.

    It is equal to ``MLPClassifier(hidden_layer_sizes, max_iter=max_iter, n_iter_no_change=max_iter, tol=0)`` with the
    same other parameters, up to rounding. The rows should have a mean of about zero and a variance of about one; they
    are not scaled here.
    """

    def fit(self, X: ArrayLike, y: ArrayLike) -> NetworkClassifier:  # noqa: N803
        """Train on rows X (n, features) and their labels y (n,)."""
        return fit_together([self], [(X, y)])[0]


def fit_together(
    networks: Sequence[NetworkClassifier], data: Sequence[tuple[ArrayLike, ArrayLike]]
) -> list[NetworkClassifier]:
    """Train each network on its own rows and labels, several together, with the same result as single ``fit`` calls.

    Networks with equal parameters and equal sizes of their data are trained together, at most :data:`TOGETHER`. One
    core is used.

    Args:
        networks: The networks, whose ``random_state`` is a whole number.
        data: The rows (n, features) and labels (n,) of each network.

    Returns:
        The same networks, fitted.

    Raises:
        ValueError: As in scikit-learn: wrong parameters, shapes or labels, NaN, or weights that overflow.
    """
    groups: dict[tuple[Any, ...], list[_Task]] = {}
    with threadpool_limits(limits=1):  # threads make products of such small matrices slower
        for network, (rows, labels) in zip(networks, data, strict=True):
            task = _Task.of(network, rows, labels)
            groups.setdefault(task.key, []).append(task)
        for tasks in groups.values():
            for first in range(0, len(tasks), TOGETHER):
                _train(tasks[first : first + TOGETHER])
    return list(networks)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Task:
    """A network with its data.

    Args:
        rows: The rows, (n, features + 1). The last column is 1, for the hidden layer's intercepts.
        targets: 1 if a row has the class of an output, otherwise 0, (outputs, n).
    """

    network: NetworkClassifier
    rows: Numbers
    targets: Numbers

    @classmethod
    def of(cls, network: NetworkClassifier, rows: ArrayLike, labels: ArrayLike) -> _Task:
        """Make a task. Training one epoch with scikit-learn checks all values and sets its attributes."""
        epochs = network.max_iter
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)
            warnings.filterwarnings("ignore", "Got `batch_size`")
            try:
                MLPClassifier.fit(network.set_params(max_iter=min(epochs, 1)), rows, labels)
            finally:
                network.set_params(max_iter=epochs)
        kind = network.coefs_[0].dtype
        values = np.asarray(rows, dtype=kind)
        index = np.searchsorted(network.classes_, np.ravel(labels))
        classes = range(1, 2) if network.n_outputs_ == 1 else range(network.n_outputs_)
        targets = np.stack([index == number for number in classes]).astype(kind)
        ones = np.ones((len(values), 1), dtype=kind)
        return cls(network=network, rows=np.concatenate([values, ones], axis=1), targets=targets)

    @property
    def key(self) -> tuple[Any, ...]:
        """The key that must be equal for networks to be trained together."""
        settings = self.network.get_params()
        del settings["random_state"]
        return (str(settings), self.rows.shape, self.targets.shape, self.rows.dtype)


class _Layers:
    """The weights of several networks in one array (networks, size), with a view for each of the two layers.

    The first layer is (networks, hidden, features + 1), and the last layer (networks, outputs, hidden + 1). Each has
    its intercepts in the last column.
    """

    def __init__(self, task: _Task, networks: int, value: float = 0.0) -> None:
        width, hidden, outputs = task.rows.shape[1], task.network.coefs_[0].shape[1], len(task.targets)
        cut = hidden * width
        self.flat = np.full((networks, cut + outputs * (hidden + 1)), value, task.rows.dtype)
        self.first = self.flat[:, :cut].reshape(networks, hidden, width)
        self.last = self.flat[:, cut:].reshape(networks, outputs, hidden + 1)
        self.both = (self.first, self.last)

    def draw(self, index: int, state: np.random.RandomState) -> None:
        """Draw a network's initial weights as ``MLPClassifier`` does: with Glorot's bound, layer by layer."""
        for layer in self.both:
            fan_out, fan_in = layer.shape[1], layer.shape[2] - 1
            bound = np.sqrt(6.0 / (fan_in + fan_out))
            layer[index, :, :-1] = state.uniform(-bound, bound, (fan_in, fan_out)).T
            layer[index, :, -1] = state.uniform(-bound, bound, fan_out)


class _Buffers:
    """The buffers for one batch of each network, with one column for each row of the batch."""

    def __init__(self, layers: _Layers, size: int) -> None:
        networks, hidden, width = layers.first.shape
        kind = layers.flat.dtype
        self.rows = np.empty((networks, size, width), kind)
        self.hidden = np.ones((networks, hidden + 1, size), kind)  # the last row stays 1, for the intercepts
        self.out = np.empty((networks, layers.last.shape[1], size), kind)
        self.back = np.empty((networks, hidden, size), kind)


def _batches(count: int, size: int) -> Iterator[slice]:
    for first in range(0, count, size):
        yield slice(first, min(first + size, count))


def _train(tasks: Sequence[_Task]) -> None:
    """Train networks with equal keys together and set their attributes.

    Raises:
        ValueError: The weights are not finite.
    """
    network, count = tasks[0].network, len(tasks[0].rows)
    layers, slopes = _Layers(tasks[0], len(tasks)), _Layers(tasks[0], len(tasks))
    penalty = _Layers(tasks[0], 1, network.alpha)
    for layer in penalty.both:
        layer[..., -1] = 0  # intercepts have no penalty
    states = [check_random_state(task.network.random_state) for task in tasks]
    for index, state in enumerate(states):
        layers.draw(index, state)
    adam = _Adam(layers.flat, network)
    batches = list(_batches(count, min(200 if network.batch_size == "auto" else network.batch_size, count)))
    spaces = {size: _Buffers(layers, size) for size in {batch.stop - batch.start for batch in batches}}
    order = [np.arange(count) for _ in tasks]
    targets = np.stack([task.targets for task in tasks])
    fitted, pull = np.empty_like(targets), np.empty_like(layers.flat)
    curves = np.empty((network.max_iter, len(tasks)))
    for epoch in range(network.max_iter):
        if network.shuffle:
            for index, (task, state) in enumerate(zip(tasks, states, strict=True)):
                permutation = np.arange(count)
                state.shuffle(permutation)
                order[index] = order[index][permutation]
                np.take(task.targets, order[index], axis=1, out=targets[index], mode="clip")
        shrunk = np.zeros(len(tasks), targets.dtype)
        for batch in batches:
            space = spaces[batch.stop - batch.start]
            for index, task in enumerate(tasks):
                task.rows.take(order[index][batch], axis=0, out=space.rows[index], mode="clip")
            _slopes(space, targets[..., batch], fitted[..., batch], layers, slopes)
            np.multiply(penalty.flat, layers.flat, out=pull)
            np.add(slopes.flat, pull, out=slopes.flat)
            np.divide(slopes.flat, batch.stop - batch.start, out=slopes.flat)
            shrunk += np.vecdot(pull, layers.flat)
            adam.step(slopes.flat)
        curves[epoch] = (_log_loss(fitted, targets) + 0.5 * shrunk) / count
    if not np.isfinite(layers.flat).all():
        raise ValueError("The network's weights are not finite. The numbers in the rows may be too large; scale them.")
    for index, task in enumerate(tasks):
        task.network.coefs_ = [layer[index, :, :-1].T.copy() for layer in layers.both]
        task.network.intercepts_ = [layer[index, :, -1].copy() for layer in layers.both]
        task.network.loss_curve_ = curves[:, index].tolist()
        task.network.loss_ = task.network.loss_curve_[-1]
        task.network.n_iter_ = network.max_iter


def _squash(out: Numbers, probabilities: Numbers) -> None:
    """Compute the softmax over the second last axis, or the logistic function for one output; overwrites ``out``."""
    if out.shape[-2] == 1:
        expit(out, out=probabilities)
        return
    np.subtract(out, out.max(axis=-2, keepdims=True), out=out)
    np.exp(out, out=out)
    np.divide(out, out.sum(axis=-2, keepdims=True), out=probabilities)


def _slopes(space: _Buffers, targets: Numbers, fitted: Numbers, layers: _Layers, slopes: _Layers) -> None:
    """Sum the derivatives of the cross entropy over a batch into ``slopes``; write the probabilities into ``fitted``.

    Args:
        space: The buffers with the rows of the batch; the other buffers are overwritten.
        targets: The targets, (networks, outputs, rows).
        fitted: The predicted probabilities, of the same shape; overwritten.
        layers: The weights of the networks.
        slopes: The derivatives by the weights; overwritten.
    """
    hidden = space.hidden[:, :-1]
    np.matmul(layers.first, space.rows.swapaxes(1, 2), out=hidden)
    np.maximum(hidden, 0, out=hidden)
    np.matmul(layers.last, space.hidden, out=space.out)
    _squash(space.out, fitted)
    np.subtract(fitted, targets, out=space.out)
    np.matmul(space.out, space.hidden.swapaxes(1, 2), out=slopes.last)
    np.matmul(layers.last[..., :-1].swapaxes(1, 2), space.out, out=space.back)
    np.greater(hidden, 0, out=hidden)  # 1 or 0: the derivative of the rectified linear unit
    np.multiply(space.back, hidden, out=space.back)
    np.matmul(space.back, space.rows, out=slopes.first)


def _log_loss(fitted: Numbers, targets: Numbers) -> NDArray[np.float64]:
    """Return the log loss summed over an epoch's rows, (networks,), with probabilities clipped as in scikit-learn."""
    if fitted.shape[1] == 1:
        true = np.where(targets[:, 0] == 1, fitted[:, 0], 1 - fitted[:, 0])
    else:
        true = np.einsum("tkn,tkn->tn", fitted, targets)
    epsilon = np.finfo(fitted.dtype).eps
    return cast(NDArray[np.float64], -np.log(np.clip(true, epsilon, 1 - epsilon)).sum(axis=1))


class _Adam:
    """The state of Adam with a network's settings. It changes the weights in place."""

    def __init__(self, values: Numbers, network: NetworkClassifier) -> None:
        self.values = values
        self.network = network
        self.steps = 0
        self.mean = np.zeros_like(values)
        self.square = np.zeros_like(values)
        self._space = np.empty_like(values)

    def step(self, slope: Numbers) -> None:
        """Make one step against a slope, which is overwritten."""
        self.steps += 1
        space, beta_1, beta_2 = self._space, self.network.beta_1, self.network.beta_2
        np.multiply(self.mean, beta_1, out=self.mean)
        np.multiply(slope, 1 - beta_1, out=space)
        np.add(self.mean, space, out=self.mean)
        np.multiply(slope, slope, out=slope)
        np.multiply(slope, 1 - beta_2, out=slope)
        np.multiply(self.square, beta_2, out=self.square)
        np.add(self.square, slope, out=self.square)
        rate = self.network.learning_rate_init * float(np.sqrt(1 - beta_2**self.steps)) / (1 - beta_1**self.steps)
        np.sqrt(self.square, out=slope)
        np.add(slope, self.network.epsilon, out=slope)
        np.multiply(self.mean, -rate, out=space)
        np.divide(space, slope, out=space)
        np.add(self.values, space, out=self.values)

"""A small convolutional network as an estimator of ``tacbench classify``, by PyTorch and skorch, on one processor core.

    tacbench classify runs --estimator examples.convolutional:Network --resolution 0.2 -o convolved

The network gets whole frames, not their principal components. Everything that it learns, including the scaling of the
frames, comes from the training set. The number of epochs is fixed, so nothing is chosen by held-out data.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from sklearn.base import BaseEstimator, ClassifierMixin
from skorch import NeuralNetClassifier
from skorch.callbacks import LRScheduler
from torch import nn


class Layers(nn.Sequential):
    """Four convolutions that each halve the size of the frame, and a linear layer."""

    def __init__(self, textures: int) -> None:
        convolutions: list[nn.Module] = []
        for before, after in [(1, 8), (8, 16), (16, 32), (32, 64)]:
            size = 5 if before == 1 else 3
            layer = nn.Conv2d(before, after, size, stride=2, padding=size // 2, bias=False)
            convolutions += [layer, nn.BatchNorm2d(after), nn.ReLU()]
        super().__init__(*convolutions, nn.Flatten(), nn.Dropout(0.5), nn.LazyLinear(textures))


class Network(ClassifierMixin, BaseEstimator):
    """Classify frames that are given as rows. ``tacbench classify`` sets the first two parameters.

    Args:
        frame_shape: Height and width of a frame in pixels.
        random_state: Seed of all random numbers.
        epochs: Number of passes through the training set.
        batch_size: Number of frames in one step.
        rate: The highest learning rate; the rate rises to it and falls again.
    """

    def __init__(
        self,
        frame_shape: tuple[int, ...] | None = None,
        random_state: int = 0,
        epochs: int = 40,
        batch_size: int = 64,
        rate: float = 3e-3,
    ) -> None:
        self.frame_shape, self.random_state = frame_shape, random_state
        self.epochs, self.batch_size, self.rate = epochs, batch_size, rate

    def fit(self, rows: Any, names: Any) -> Network:
        """Train a new network."""
        torch.set_num_threads(1)  # the other cores run other trials, and sums are always rounded in the same way
        self.classes_, numbers = np.unique(names, return_inverse=True)
        self.mean_, self.scale_ = float(np.mean(rows)), float(np.std(rows))
        steps = -(-len(rows) // self.batch_size) * self.epochs
        rate = LRScheduler(torch.optim.lr_scheduler.OneCycleLR, max_lr=self.rate, total_steps=steps, step_every="batch")
        self.net_ = NeuralNetClassifier(
            Layers,
            module__textures=len(self.classes_),
            criterion=nn.CrossEntropyLoss,
            optimizer=torch.optim.AdamW,
            max_epochs=self.epochs,
            batch_size=self.batch_size,
            iterator_train__shuffle=True,
            train_split=None,
            callbacks=[rate],
            verbose=0,
        )
        torch.manual_seed(self.random_state)
        frames = self._frames(rows)
        self.net_.initialize()
        self.net_.notify("on_train_begin", X=frames, y=numbers)
        self.net_.fit_loop(frames, numbers)  # skorch's own fit ends the training at Ctrl-C without an error
        return self

    def predict(self, rows: Any) -> Any:
        """Return the predicted textures, shape (n,)."""
        return self.classes_[self.net_.predict(self._frames(rows))]

    def _frames(self, rows: Any) -> Any:
        """Scale the rows and give them the shape of the first layer's input, (n, 1, height, width)."""
        if self.frame_shape is None or len(self.frame_shape) != 2:
            raise ValueError("needs whole images: no principal components, no markers, and --roi none")
        return ((np.asarray(rows, dtype=np.float32) - self.mean_) / self.scale_).reshape(-1, 1, *self.frame_shape)

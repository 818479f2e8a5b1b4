"""A vision network with published weights that computes features for a logistic regression in ``tacbench classify``.

    tacbench classify runs --estimator examples.frozen_backbone:classifier --noise none --brightness none -o frozen

The network is frozen: it is not trained here. The working folder must contain ``resnet18.pth``, the weights of a
ResNet-18 (He et al. 2016) with torchvision's names. torchvision and timm publish such files, or you train the
network on tactile images. The file cannot run code: only numbers are read from it, and the layers are defined here.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from torch import nn

WEIGHTS = Path("resnet18.pth")
#: Other files that the result depends on: if one of them changes, `tacbench classify` runs its trials again.
FILES = (WEIGHTS,)
#: Mean and standard deviation of ImageNet's channels. The network expects images that are scaled by them.
MEAN, SCALE = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
BATCH_SIZE = 32


class Residual(nn.Module):
    """Two convolutions, and the sum of their result and their input."""

    def __init__(self, before: int, after: int) -> None:
        super().__init__()
        stride = 1 if before == after else 2
        self.conv1, self.bn1 = nn.Conv2d(before, after, 3, stride, 1, bias=False), nn.BatchNorm2d(after)
        self.conv2, self.bn2 = nn.Conv2d(after, after, 3, 1, 1, bias=False), nn.BatchNorm2d(after)
        if stride == 2:
            self.downsample = nn.Sequential(nn.Conv2d(before, after, 1, 2, bias=False), nn.BatchNorm2d(after))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the sum, after a ReLU."""
        shortcut = self.downsample(x) if hasattr(self, "downsample") else x
        return torch.relu(shortcut + self.bn2(self.conv2(torch.relu(self.bn1(self.conv1(x))))))


class ResNet18(nn.Sequential):
    """A ResNet-18 without its last layer: it gives 512 numbers for each image."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1, self.bn1 = nn.Conv2d(3, 64, 7, 2, 3, bias=False), nn.BatchNorm2d(64)
        self.relu, self.maxpool = nn.ReLU(), nn.MaxPool2d(3, 2, 1)
        for number, (before, after) in enumerate([(64, 64), (64, 128), (128, 256), (256, 512)], start=1):
            self.add_module(f"layer{number}", nn.Sequential(Residual(before, after), Residual(after, after)))
        self.pool, self.flatten = nn.AdaptiveAvgPool2d(1), nn.Flatten()


class FrozenBackbone(TransformerMixin, BaseEstimator):
    """Turn frames into features by a frozen network. ``tacbench classify`` sets ``frame_shape``."""

    def __init__(self, weights: Path = WEIGHTS, frame_shape: tuple[int, ...] | None = None) -> None:
        self.weights, self.frame_shape = weights, frame_shape

    def fit(self, rows: Any, names: Any = None) -> FrozenBackbone:
        """Read the weights."""
        weights = torch.load(self.weights, map_location="cpu", weights_only=True)
        backbone = ResNet18()
        backbone.load_state_dict({name: tensor for name, tensor in weights.items() if not name.startswith("fc.")})
        self.backbone_ = backbone.eval()
        return self

    def transform(self, rows: Any) -> Any:
        """Return the features, shape (n, 512)."""
        if self.frame_shape is None or len(self.frame_shape) != 2:
            raise ValueError("needs whole images: no principal components, no markers, and --roi none")
        torch.set_num_threads(1)
        mean, scale = (torch.tensor(values).reshape(3, 1, 1) for values in (MEAN, SCALE))
        frames = torch.as_tensor(np.asarray(rows, dtype=np.float32).reshape(-1, 1, *self.frame_shape) / 255.0)
        with torch.inference_mode():
            return torch.cat([self.backbone_((batch - mean) / scale) for batch in frames.split(BATCH_SIZE)]).numpy()


def classifier() -> Any:
    """Return the untrained estimator."""
    return make_pipeline(FrozenBackbone(), StandardScaler(), LogisticRegression(max_iter=1000))

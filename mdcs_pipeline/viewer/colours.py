"""Colours of nodes and branches, as red, green and blue from 0 to 255."""

from __future__ import annotations

import colorsys

import numpy as np
from numpy.typing import NDArray

Colours = NDArray[np.uint8]

# Viridis at equal steps: even to the eye, and told apart by those who see fewer colours.
_VIRIDIS = np.array(
    [
        (68, 1, 84),
        (71, 44, 122),
        (59, 81, 139),
        (44, 113, 142),
        (33, 144, 141),
        (39, 173, 129),
        (92, 200, 99),
        (170, 220, 50),
        (253, 231, 37),
    ],
    dtype=np.float64,
)
# Turned by the golden ratio, neighbours in number are far apart in hue.
_TURN = (5**0.5 - 1) / 2
_SHADES = (0.85, 0.6)
JUNCTION = np.array([60, 60, 60], np.uint8)


def value_range(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return what the two ends of the colour scale mean: 5th and 95th percentile.

    The few extremes, which would leave all others one colour, take the colour of the end.
    """
    if not len(values):
        return 0.0, 0.0
    low, high = np.quantile(values, [0.05, 0.95])
    return float(low), float(high)


def by_value(values: NDArray[np.float64]) -> Colours:
    """Return a (K, 3) colour for each value, dark for small, light for large."""
    low, high = value_range(values)
    share = (values - low) / (high - low) if high > low else np.full(len(values), 0.5)
    place = np.clip(share, 0.0, 1.0) * (len(_VIRIDIS) - 1)
    steps = np.arange(len(_VIRIDIS))
    mixed = np.stack([np.interp(place, steps, channel) for channel in _VIRIDIS.T], axis=1)
    chosen: Colours = np.rint(mixed).astype(np.uint8)
    return chosen


def by_label(labels: NDArray[np.int64]) -> Colours:
    """Return a (E, 3) colour for each label; labels that follow each other differ most."""
    shades = [
        colorsys.hsv_to_rgb((0.6 + label * _TURN) % 1.0, 0.9, _SHADES[label % len(_SHADES)])
        for label in range(int(labels.max(initial=-1)) + 1)
    ]
    table = np.rint(np.array(shades).reshape(-1, 3) * 255).astype(np.uint8)
    chosen: Colours = table[labels]
    return chosen

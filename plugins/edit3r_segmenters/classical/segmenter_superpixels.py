"""Superpixels of a picture with what merging and scoring need to know of them."""

from dataclasses import dataclass

import cv2
import numpy as np
from skimage.color import rgb2lab
from skimage.segmentation import slic

COUNT = 350  # superpixels asked for
PALETTE = 40  # colours a picture is quantised to for histograms
EDGE_QUANTILE = 0.97  # gradient that counts as a full edge


@dataclass(frozen=True)
class Superpixels:
    """N superpixels of a picture of H x W pixels."""

    labels: np.ndarray  # [H, W] int, 0 to N - 1
    areas: np.ndarray  # [N], pixels
    colours: np.ndarray  # [N, 3], mean CIE Lab
    histograms: np.ndarray  # [N, PALETTE], pixels per palette colour
    pairs: np.ndarray  # [E, 2] int, neighbours, smaller index first
    borders: np.ndarray  # [E], length of their common border [pixels]
    strengths: np.ndarray  # [E], mean edge strength along it, in [0, 1]
    palette_index: np.ndarray  # [H, W] int, palette colour of every pixel
    edges: np.ndarray  # [H, W] float, edge strength in [0, 1]


def superpixels(image: np.ndarray) -> Superpixels:
    """Superpixels of an sRGB picture `[H, W, 3]` in [0, 1], about `COUNT` of them or fewer on tiny pictures."""
    height, width = image.shape[:2]
    lab = rgb2lab(image).astype(np.float32)
    wanted = int(np.clip(height * width // 16, 1, COUNT))
    labels = slic(image, wanted, compactness=10, sigma=0.5, start_label=0).astype(np.int64)
    labels = np.unique(labels, return_inverse=True)[1].reshape(height, width)
    count = labels.max() + 1
    flat = labels.ravel()
    areas = np.bincount(flat, minlength=count).astype(np.float64)
    colours = np.stack([np.bincount(flat, lab[..., c].ravel(), count) / areas for c in range(3)], 1)
    palette_index = _quantised(lab)
    histograms = np.bincount(flat * PALETTE + palette_index.ravel(), minlength=count * PALETTE)
    edges = _edge_strength(lab)
    pairs, borders, strengths = _neighbours(labels, edges)
    return Superpixels(
        labels, areas, colours, histograms.reshape(count, PALETTE).astype(np.float64),
        pairs, borders, strengths, palette_index, edges,
    )  # fmt: skip


def _quantised(lab: np.ndarray) -> np.ndarray:
    """Palette index per pixel: k-means from seeded centres, lightness counting half."""
    weighted = (lab * np.array([0.5, 1, 1], np.float32)).reshape(-1, 3)
    sample = weighted[:: max(1, len(weighted) // 4000)]
    if len(sample) == 1:  # cv2 takes a single row for a column
        return np.zeros(lab.shape[:2], np.int64)
    clusters = min(PALETTE, len(np.unique(sample, axis=0)))
    cv2.setRNGSeed(0)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 15, 0.5)
    _, _, centres = cv2.kmeans(sample, clusters, None, criteria, 1, cv2.KMEANS_PP_CENTERS)
    distance = (weighted**2).sum(1, keepdims=True) - 2 * weighted @ centres.T + (centres**2).sum(1)
    return distance.argmin(1).reshape(lab.shape[:2])


def _edge_strength(lab: np.ndarray) -> np.ndarray:
    """Gradient of Lab after slight smoothing, 1 at the picture's strong edges."""
    smooth = cv2.GaussianBlur(lab, (0, 0), 1.0)
    gradient = sum(cv2.Sobel(smooth, cv2.CV_32F, dx, dy, ksize=3) ** 2 for dx, dy in ((1, 0), (0, 1))).sum(2) ** 0.5
    return np.clip(gradient / max(float(np.quantile(gradient, EDGE_QUANTILE)), 1e-3), 0, 1)


def _neighbours(labels: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of touching superpixels, length of their border, mean edge strength along it."""
    first, second, strength = [], [], []
    for a, b in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        touching = labels[a] != labels[b]
        first.append(labels[a][touching])
        second.append(labels[b][touching])
        strength.append(np.maximum(edges[a], edges[b])[touching])
    pairs = np.sort(np.stack([np.concatenate(first), np.concatenate(second)], 1), 1)
    pairs, inverse = np.unique(pairs, axis=0, return_inverse=True)
    inverse = inverse.ravel()
    borders = np.bincount(inverse, minlength=len(pairs)).astype(np.float64)
    return pairs, borders, np.bincount(inverse, np.concatenate(strength), len(pairs)) / np.maximum(borders, 1)

"""Pictures coded for bright screens (PQ and HLG), as sRGB.

The transfer functions are those of ITU-R BT.2100, the numbers those of ITU-T H.273, by which PNG
(chunk cICP), HEIC and AVIF (colr, nclx) say them.
"""

import re
import struct
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
from PIL import Image

PQ, HLG = 16, 18
BT2020, DISPLAY_P3 = 9, 12
WHITE = 203.0  # light of a white sheet [cd/m2], ITU-R BT.2408
PEAK = 1000.0  # of the screen that HLG is graded for
KNEE = 0.8  # of sRGB's levels: what is brighter is pressed together
_HEAD = 1 << 16  # bytes in which the numbers stand
_TO_709 = {
    BT2020: (
        (1.6605, -0.5876, -0.0728),
        (-0.1246, 1.1329, -0.0083),
        (-0.0182, -0.1006, 1.1187),
    ),
    DISPLAY_P3: (
        (1.2249, -0.2247, 0.0),
        (-0.0420, 1.0419, 0.0),
        (-0.0197, -0.0786, 1.0979),
    ),
}


@dataclass(frozen=True)
class Coding:
    """How a file says that its colours are coded."""

    primaries: int
    transfer: int

    @property
    def name(self) -> str:
        """PQ or HLG, or nothing for what is no such coding."""
        return {PQ: "PQ", HLG: "HLG"}.get(self.transfer, "")


def read_coding(file: BinaryIO) -> Coding | None:
    """The numbers in the head of a PNG, HEIC or AVIF."""
    head = file.read(_HEAD)
    if head.startswith(b"\x89PNG"):
        at = 8
        while at + 12 <= len(head):
            (length,) = struct.unpack_from(">I", head, at)
            kind = head[at + 4 : at + 8]
            if kind == b"cICP" and length >= 4:
                return Coding(head[at + 8], head[at + 9])
            if kind == b"IDAT":
                return None
            at += 12 + length
    elif head[4:8] == b"ftyp":
        numbers = re.search(rb"colrnclx(..)(..)", head, re.DOTALL)
        if numbers:
            return Coding(
                *(int.from_bytes(number, "big") for number in numbers.groups())
            )
    return None


def as_srgb(image: Image.Image, coding: Coding) -> Image.Image:
    """The picture as a screen without HDR shows it: light above white pressed into what is left."""
    coded = np.asarray(image.convert("RGB"))
    levels = np.arange(256) / 255
    light = _pq(levels) if coding.transfer == PQ else _hlg(levels)
    matrix = np.asarray(_TO_709.get(coding.primaries, np.eye(3)), np.float32)
    shown = np.empty_like(coded)
    # in strips: floats take four times the memory
    for row in range(0, len(coded), 256):
        part = light.astype(np.float32)[coded[row : row + 256]]
        if coding.transfer == HLG:  # the screen's own gamma, by luminance
            luminance = part @ np.array([0.2627, 0.6780, 0.0593], np.float32)
            part *= np.maximum(luminance, 1e-6)[..., None] ** 0.2 * (PEAK / WHITE)
        part = np.maximum(part @ matrix.T, 0)
        shown[row : row + 256] = np.rint(255 * _pressed(_srgb(part)))
    return Image.fromarray(shown)


def _pq(levels: np.ndarray) -> np.ndarray:
    """Light [shares of WHITE] of PQ's levels."""
    m1, m2, c1, c2, c3 = 0.1593017578125, 78.84375, 0.8359375, 18.8515625, 18.6875
    root = levels ** (1 / m2)
    return (np.maximum(root - c1, 0) / (c2 - c3 * root)) ** (1 / m1) * (10_000 / WHITE)


def _hlg(levels: np.ndarray) -> np.ndarray:
    """Light of the scene, from 0 to 1, of HLG's levels."""
    a, b, c = 0.17883277, 0.28466892, 0.55991073
    return np.where(levels <= 0.5, levels**2 / 3, (np.exp((levels - c) / a) + b) / 12)


def _srgb(light: np.ndarray) -> np.ndarray:
    return np.where(
        light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055
    )


def _pressed(levels: np.ndarray) -> np.ndarray:
    most = float(_srgb(np.array(PEAK / WHITE)))
    over = np.clip((levels - KNEE) / (most - KNEE), 0, 1)
    # begins as steep as below the knee, and ends flat at 1
    slope = (most - KNEE) / (1 - KNEE)
    return np.where(
        levels <= KNEE, levels, KNEE + (1 - KNEE) * (1 - (1 - over) ** slope)
    )

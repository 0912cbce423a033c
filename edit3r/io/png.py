"""8-bit RGB pictures as PNG, by OpenCV: its filter and strategy (SUB, RLE) take half the time of Pillow's level 1."""

import cv2
import numpy as np
from jaxtyping import UInt8

__all__ = ["Pixels", "decode_png", "encode_png"]

Pixels = UInt8[np.ndarray, "height width 3"]


def encode_png(pixels: Pixels) -> bytes:
    """The file's content; the same pixels give the same bytes."""
    good, content = cv2.imencode(".png", cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR))
    if not good:
        raise ValueError(f"a picture of shape {list(pixels.shape)} cannot be coded as PNG")
    return content.tobytes()


def decode_png(content: bytes) -> Pixels:
    """The pixels of a file that `encode_png` made. Raises ValueError for one that is damaged."""
    picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR) if content else None
    if picture is None:
        raise ValueError("the PNG is damaged")
    return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)

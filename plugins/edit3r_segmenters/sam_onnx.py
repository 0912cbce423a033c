"""SAM 2 (Ravi et al. 2024) as two ONNX files: an encoder that reads an image once, and a decoder
that answers clicks and boxes and takes what the encoder gives, by name.

The decoder's several masks and how good it believes they are are inner values of its graph; they
are made outputs when the file is loaded.
"""

import threading
from collections.abc import Callable, Hashable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Box, Click, MaskLogits, Segmenter
from edit3r.kit.cache import fingerprint, recall
from edit3r.kit.compute.perceptual import IMAGENET_MEAN, IMAGENET_STD
from edit3r.kit.weights.find import find
from edit3r.kit.weights.onnx import onnx_session, require_onnx_file, run_onnx
from edit3r_segmenters import SAM2_ONNX

MEAN = np.float32(255 * np.array(IMAGENET_MEAN))
STD = np.float32(255 * np.array(IMAGENET_STD))
SIDE = 1024  # of the encoder's square input [pixels]
MASK_SIDE = 256  # of a mask that is told with clicks [pixels]
# answers that stay in memory: a click is asked for its photo, then for all, then with steps; what
# stands out is asked with 36 clicks
MAX_ANSWERS = 64
MAX_KEPT = 8  # images whose embeddings stay in memory: clicks follow each other on one
OUT, IN, CORNERS = 0.0, 1.0, (2.0, 3.0)  # labels of points
FLOAT_TENSOR = b"\x0a\x02\x08\x01"  # ONNX TypeProto: a tensor of float32
OUTPUTS = ("/Reshape_8_output_0", "/iou_prediction_head/Sigmoid_output_0")
"""What the decoder calls its four masks and their quality, as exported."""

Embedding = dict[str, Tensor]
"""What the encoder gives, by the name of the decoder's input."""
Known = TypeVar("Known")


class Latest(Generic[Known]):
    """What was computed of the picture that was asked about last: questions follow each other on
    one, which is told by its identity. Nobody changes a picture in place. Threads may ask at once.
    """

    def __init__(self) -> None:
        self._held: tuple[Any, Known] | None = None

    def of(self, picture: Any, compute: Callable[[], Known]) -> Known:
        held = self._held
        if held is None or held[0] is not picture:
            held = self._held = picture, compute()
        return held[1]


class SamOnnxSegmenter(Segmenter):
    """The network's masks for clicks and boxes."""

    class Settings(edit3r.Settings):
        encoder: str = ""
        """ONNX file of the encoder; empty: that of the weights"""
        decoder: str = ""
        """ONNX file of the decoder; empty: likewise"""

    settings: Settings

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        if bool(settings.encoder) != bool(settings.decoder):
            raise InputError(
                "sam-onnx: give both files, encoder and decoder, or neither."
            )
        if settings.encoder:
            files = [Path(settings.encoder), Path(settings.decoder)]
        else:
            folder = find(SAM2_ONNX)
            files = [folder / SAM2_ONNX.stored(one) for one, _ in SAM2_ONNX.files]
        self._encoder_file, self._decoder_file = files
        self._encoder: Any = None
        self._decoder: Any = None
        self._embeddings: dict[str, Embedding] = {}
        self._reading = threading.Lock()  # threads may ask at once
        self._latest: Latest[tuple[str, Embedding]] = Latest()
        self._answers: dict[Hashable, tuple[np.ndarray, np.ndarray]] = {}

    def masks(
        self,
        image: Float[Tensor, "3 height width"],
        clicks: Sequence[Click],
        box: Box | None = None,
        before: Float[Tensor, "h w"] | None = None,
    ) -> MaskLogits:
        """All masks of the network, at its own resolution, and their predicted IoU."""
        given = None if before is None else before.numpy(force=True)
        logits, quality = self._ask(image, clicks, box, given)
        return MaskLogits(torch.from_numpy(logits), torch.from_numpy(quality))

    def _ask(
        self,
        image: Float[Tensor, "3 height width"],
        clicks: Sequence[Click],
        box: Box | None,
        before: np.ndarray | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Logits `[n, h, w]` and predicted IoU `[n]`; to a question asked before from memory."""
        read, embedding = self._embedding(image)
        told = None if before is None else before.tobytes()
        asked = (read, tuple(clicks), box, told)
        if asked not in self._answers:
            answer = self._answer(embedding, clicks, box, before)
            if len(self._answers) >= MAX_ANSWERS:  # the first goes
                self._answers.pop(next(iter(self._answers)), None)
            self._answers[asked] = answer
            return answer
        return self._answers[asked]

    def _answer(
        self,
        read: Embedding,
        clicks: Sequence[Click],
        box: Box | None,
        before: np.ndarray | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        places = [place for place, _ in clicks]
        labels = [IN if inside else OUT for _, inside in clicks]
        if box is not None:
            x, y, width, height = box
            places += [(x, y), (x + width, y + height)]
            labels += CORNERS
        if before is None:
            mask = np.zeros((MASK_SIDE, MASK_SIDE), np.float32)
        else:
            mask = np.float32(cv2.resize(before, (MASK_SIDE, MASK_SIDE)))
        return self._decode(
            {
                **{name: one.numpy() for name, one in read.items()},
                "point_coords": SIDE * np.array(places, np.float32)[None],
                "point_labels": np.array(labels, np.float32)[None],
                "mask_input": mask[None, None],
                "has_mask_input": np.array([before is not None], np.float32),
                # the size to which a mask that is not asked for is enlarged
                "orig_im_size": np.array([32, 32], np.float32),
            }
        )

    def _embedding(
        self, image: Float[Tensor, "3 height width"]
    ) -> tuple[str, Embedding]:
        return self._latest.of(image, lambda: self._read(image))

    def _read(self, image: Float[Tensor, "3 height width"]) -> tuple[str, Embedding]:
        """What the image is known by, and what the encoder reads of it."""
        # Files given by hand are part of the question.
        require_onnx_file(self._encoder_file)
        files = [str(self._encoder_file), self._encoder_file.stat().st_mtime_ns]
        key = fingerprint(image, files)
        compute = partial(self._encoded_once, key, image)
        return key, {
            name: one.float() for name, one in recall("embed", self, key, compute)
        }

    def _encoded_once(
        self, key: str, image: Float[Tensor, "3 height width"]
    ) -> tuple[tuple[str, Tensor], ...]:
        """What the encoder reads, as float16 to need half the memory, for the last few images."""
        known = self._embeddings.get(key)
        if known is None:
            with self._reading:  # who asks for the same meanwhile finds it then
                known = self._embeddings.get(key)
                if known is None:
                    read = self._encode(image)
                    known = {name: one.half() for name, one in read.items()}
                    if len(self._embeddings) >= MAX_KEPT:  # the first read goes
                        del self._embeddings[next(iter(self._embeddings))]
                    self._embeddings[key] = known
        return tuple(known.items())

    def _encode(self, image: Float[Tensor, "3 height width"]) -> Embedding:
        """What the encoder reads of the image, squashed to its square."""
        if self._encoder is None:
            self._encoder = _load(self._encoder_file)
        pixels = image.detach().cpu().float().clamp(0, 1).permute(1, 2, 0).numpy() * 255
        square = (cv2.resize(pixels, (SIDE, SIDE)) - MEAN) / STD
        read = _run(
            self._encoder,
            self._encoder_file,
            None,
            {self._encoder.get_inputs()[0].name: square.transpose(2, 0, 1)[None]},
        )
        names = [one.name for one in self._encoder.get_outputs()]
        return dict(zip(names, map(torch.from_numpy, read)))

    def _decode(self, known: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Logits `[n, h, w]` and quality `[n]` for those of the `known` inputs that it takes."""
        if self._decoder is None:
            self._decoder = _load(self._decoder_file, OUTPUTS)
        wanted = [one.name for one in self._decoder.get_inputs()]
        strange = sorted(set(wanted) - set(known))
        if strange:
            raise InputError(
                f"{self._decoder_file}: asks for {', '.join(strange)}; expected a SAM 2's decoder, "
                "with the inputs that the encoder gives."
            )
        feeds = {name: known[name] for name in wanted}
        logits, quality = _run(self._decoder, self._decoder_file, list(OUTPUTS), feeds)
        if logits.ndim != 4 or quality.shape != logits.shape[:2] or len(logits) != 1:
            raise InputError(
                f"{self._decoder_file}: its masks {list(logits.shape)} and their quality "
                f"{list(quality.shape)} do not fit; expected [1, n, h, w] and [1, n]."
            )
        return logits[0], quality[0]


def _load(path: Path, outputs: Sequence[str] = ()) -> Any:
    """An ONNX file as a session on the CPU, with inner values named `outputs` as outputs."""
    require_onnx_file(path)
    content = path.read_bytes()
    session = _session(path, content)
    known = {one.name for one in session.get_outputs()}
    inner = [name for name in outputs if name not in known]
    return _session(path, content + _declared(inner)) if inner else session


def _session(path: Path, content: bytes) -> Any:
    return onnx_session(
        path,
        content,
        "the file is damaged, or none of a SAM 2.",
    )


def _run(session: Any, path: Path, outputs: list[str] | None, feeds: dict) -> list:
    return run_onnx(
        session,
        path,
        outputs,
        feeds,
        fault="does not take what a SAM 2 takes",
        advice=f"fetch both anew with: {SAM2_ONNX.get}.",
    )


def _declared(names: Sequence[str]) -> bytes:
    """Bytes that, added to an ONNX file, make inner values outputs.

    The file is a protobuf message, and of a field that comes twice the contents are merged: what is
    added is a model with a graph that has only outputs.
    """
    graph = b"".join(
        _field(12, _field(1, name.encode()) + _field(2, FLOAT_TENSOR)) for name in names
    )
    return _field(7, graph)


def _field(number: int, content: bytes) -> bytes:
    """A field of a protobuf message that holds bytes, in the form: key, length, content."""
    length, left = b"", len(content)
    while left >= 128:
        length += bytes([left % 128 + 128])
        left //= 128
    return bytes([number << 3 | 2]) + length + bytes([left]) + content

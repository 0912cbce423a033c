"""Where an image shows what one of ImageNet's 1,000 words names: class activation maps (Zhou et al.
2016) of EfficientNet-lite0.
"""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Detection, Detector
from edit3r.kit.compute.perceptual import efficientnet_input
from edit3r.kit.weights.find import find
from edit3r.kit.weights.load import foreign
from edit3r_segmenters import EFFICIENTNET
from edit3r_segmenters.words import imagenet_classes, imagenet_names

PICTURE_SIDE = 224  # of a picture that is looked at as a whole [pixels]
CORE = 0.5  # share of the map's peak above which a place belongs to the thing


class ImagenetDetector(Detector):
    """One thing an image; for words that ImageNet does not have it finds nothing."""

    class Settings(edit3r.Settings):
        size: int = Field(
            448, ge=64, le=2048, description="side of the network's input [pixels]"
        )

    settings: Settings

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._file = find(EFFICIENTNET)
        self._network: Any = None

    def knows(self, text: str) -> bool:
        return bool(imagenet_classes(text))

    def detect(
        self, image: Float[Tensor, "3 height width"], text: str
    ) -> tuple[Detection, ...]:
        found = self.activation(image, text)
        if found is None:
            return ()
        label, probability, heat = found
        core = (heat > CORE).astype(np.uint8)
        labels = cv2.connectedComponents(core)[1]
        peak = np.unravel_index(heat.argmax(), heat.shape)
        box = cv2.boundingRect((labels == labels[peak]).astype(np.uint8))
        return (Detection(label, probability, tuple(map(float, box))),)

    @torch.no_grad()
    def activation(
        self, image: Float[Tensor, "3 height width"], text: str
    ) -> tuple[str, float, np.ndarray] | None:
        """Name of the class that the text names and the image shows most, probability of all that
        the text names beyond their share of the classes (a dog is one of 118), and the activation
        map `[height, width]` with a peak of 1; None for a word that is not known.
        """
        classes = list(imagenet_classes(text))
        if not classes:
            return None
        maps, bias = self._maps([image], self.settings.size)
        maps = maps[0]
        logits = maps.mean((1, 2)) + bias
        shares = logits.softmax(0)
        best = classes[int(logits[classes].argmax())]
        heat = maps[classes].amax(0) - maps.mean(0)
        heat = (heat / heat.max().clamp(min=1e-6)).clamp(min=0).numpy()
        height, width = image.shape[-2:]
        heat = cv2.resize(heat, (width, height), interpolation=cv2.INTER_CUBIC)
        name = imagenet_names()[best].split(",")[0]
        beyond_chance = float(shares[classes].sum()) - len(classes) / len(shares)
        return name, max(0.0, beyond_chance), np.clip(heat, 0, 1)

    @torch.no_grad()
    def likeness(
        self, pictures: Sequence[Float[Tensor, "3 _height _width"]], text: str
    ) -> Float[Tensor, "picture"]:
        """Logit of what a text names, for each picture as a whole."""
        maps, bias = self._maps(pictures, PICTURE_SIDE)
        classes = list(imagenet_classes(text))
        return (maps.mean((2, 3)) + bias)[:, classes].amax(1)

    def _maps(
        self, pictures: Sequence[Float[Tensor, "3 _height _width"]], size: int
    ) -> tuple[Float[Tensor, "picture 1000 height width"], Float[Tensor, "1000"]]:
        """Activation of each class at each place, and what is added to its mean for the logit."""
        if self._network is None:
            self._network = self._load()
        shown = [efficientnet_input(one[None].cpu().float(), size) for one in pictures]
        features = self._network.extract_features(torch.cat(shown))
        layer = self._network._fc
        return torch.einsum("kc,nchw->nkhw", layer.weight, features), layer.bias

    def _load(self) -> Any:
        """Raises InputError for a file that does not hold this network."""
        network = foreign("efficientnet_lite_pytorch", "EfficientNet")
        built = network.from_name("efficientnet-lite0")
        try:
            state = torch.load(self._file, map_location="cpu", weights_only=True)
            built.load_state_dict(state)
        except Exception as error:  # of many classes, by what is damaged
            raise InputError(
                f"{self._file}: holds no EfficientNet-lite0 ({type(error).__name__}); fetch it "
                f"anew with: {EFFICIENTNET.get}"
            ) from None
        return built.eval().requires_grad_(False)

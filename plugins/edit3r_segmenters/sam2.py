"""SAM2 (Ravi et al. 2024), the paper's segmenter; words become boxes by a detector, and boxes masks."""

from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r.cache import remembered
from edit3r.config import PartChoice
from edit3r.interfaces import Detector, Proposal
from edit3r_segmenters.sam import SamSegmenter, SamSettings


class Sam2Segmenter(SamSegmenter):
    """Masks of one image by grid, point, box or words, and their tracks through the other views."""

    image_class, video_class = "Sam2Model", "Sam2VideoModel"
    session = "transformers.models.sam2_video.modeling_sam2_video:Sam2VideoInferenceSession"
    mean, std = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
    threshold_key = "segmenter.detector.box_threshold"

    class Settings(SamSettings):
        model: str = Field("facebook/sam2.1-hiera-large", description="model id on the hub, or a saved folder")
        detector: PartChoice = Field(PartChoice(name="grounding-dino"), description="finds what the words name")

    def __init__(self, settings: Settings, detector: Detector) -> None:
        super().__init__(settings)
        self.detector = detector

    @remembered
    def segment_text(self, image: Float[Tensor, "3 height width"], text: str) -> tuple[Proposal, ...]:
        height, width = image.shape[-2:]
        boxes = [detection.box for detection in self.detector.detect(image, text)]
        return tuple(self.segment(image, box=(x / width, y / height, w / width, h / height)) for x, y, w, h in boxes)

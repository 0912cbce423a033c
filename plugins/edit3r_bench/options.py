"""What the steps of `edit3r bench` are asked for; their flags are made from it, without torch."""

from pydantic import Field

from edit3r.contract.settings import PartChoice, Settings


class BuildOptions(Settings):
    """What a benchmark is built of."""

    out: str = "bench.json"
    """the manifest to write"""
    procedural: int | None = Field(None, ge=1)
    """generate N scenes with five edits each instead"""
    size: int | None = Field(None, ge=32, le=4096)
    """longer side of the images [pixels] (photos 256, generated 128)"""
    seed: int = Field(2026, ge=0)
    """of generated scenes and of edits"""
    scenes: int | None = Field(None, ge=1)
    """take N scenes of the folder, drawn by --seed; the paper has 20"""
    views: int = Field(2, ge=2, le=32)
    """input photos of scenes without poses, evenly spaced"""
    labels: str = ""
    """what the photos show, with commas between; with --detector what it looks for"""
    detector: PartChoice | None = None
    """finds labels and boxes, such as grounding-dino"""
    segmenter: PartChoice | None = None
    """cuts masks out of the boxes, such as sam2 or grabcut"""
    truth: PartChoice | None = None
    """editor, such as recolor, that edits the held-back photos too: its images are the truth"""
    llm: str = ""
    """OpenAI-compatible address of a language model that proposes edits"""
    llm_model: str = ""
    """its name there; its key is read from OPENAI_API_KEY"""
    llm_photos: int = Field(8, ge=0)
    """photos of a scene it is shown at most"""
    vetting: str = ""
    """vetting file; default: beside --out, NAME.vetting.yaml"""
    no_vetting: bool = False
    """take the first five proposals of each scene unseen"""


class MetricSettings(Settings):
    """Which networks metrics are measured with."""

    no_effnet: bool = False
    """leave out what EfficientNet's features measure"""
    inception: str = ""
    """measure C-FID and C-KID with this inception-2015-12-05.pt"""
    clip: str = ""
    """measure CLIP t2i and direction with this model or folder"""
    lpips: bool = False
    """measure LPIPS against the truth (extra lpips)"""


class RunOptions(MetricSettings):
    """Which method does which items, and by how many workers."""

    editor: str = ""
    """2D editor; default: 'oracle', the offline stand-in that knows the truth"""
    reconstructor: str = ""
    """reconstructor; default: edit3r"""
    rasterizer: str = ""
    """draws the images; default: auto"""
    scenes: int | None = Field(None, ge=1)
    """only the first N scenes"""
    edits: int | None = Field(None, ge=1)
    """only the first N edits of each scene"""
    workers: int = Field(1, ge=1)
    """processes; the results are the same"""
    ray: bool = False
    """spread the workers with Ray instead, here or over RAY_ADDRESS"""
    threads: int = Field(1, ge=1)
    """threads of each worker"""

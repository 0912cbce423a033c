"""The settings that every diffusion editor shares."""

from typing import Literal

from pydantic import Field

from edit3r.config import Settings


class DiffusionSettings(Settings):
    """Which weights, where they run, and how much memory they may take."""

    model: str = Field(description="model id on the Hugging Face hub, or a folder written by save_pretrained")
    revision: str = Field("", description="branch, tag or commit of the model; empty: the newest")
    variant: str = Field("", description="weight file variant such as fp16; empty: the full-precision files")
    local_files_only: bool = Field(False, description="never download: use the folder or what is already in the cache")
    steps: int = Field(20, ge=1, le=1000, description="denoising steps; more is slower and sometimes cleaner")
    resolution: int = Field(
        512, ge=0, le=4096, description="longer side the model works at [pixels]; the result is resized back; 0: as is"
    )
    negative_prompt: str = Field("", description="what the edit should not look like")
    device: str = Field("auto", description="cpu, cuda, cuda:1, mps, ...; auto: where the photos are (--device)")
    dtype: Literal["auto", "float32", "float16", "bfloat16"] = Field(
        "auto", description="precision of the weights; auto: float32 on a CPU, half precision elsewhere"
    )
    offload: Literal["none", "model", "sequential"] = Field(
        "none", description="keep parts in main memory while they are idle: model (a little slower), sequential (much)"
    )
    low_memory: bool = Field(False, description="encode and decode one picture and tile at a time: a smaller peak")

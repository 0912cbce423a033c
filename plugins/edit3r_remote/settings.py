"""The settings that every remote editor shares."""

from pydantic import Field

from edit3r.config import Settings


class RemoteSettings(Settings):
    """Which service answers, how patiently, and what its tokens cost. Keys come from the environment alone."""

    model: str = Field(description="the service's name of the model")
    base_url: str = Field("", description="address of a compatible service; empty: the service's own")
    timeout_s: float = Field(180.0, gt=0, le=3600, description="time limit of one attempt [s]")
    attempts: int = Field(4, ge=1, le=20, description="tries per view when the service is busy or fails (429, 5xx)")
    concurrent: int = Field(2, ge=1, le=32, description="views sent at the same time")
    cache: str = Field(
        "~/.cache/edit3r/remote", description="folder of paid answers, used again for equal requests; empty: keep none"
    )
    input_price: float = Field(ge=0, description="price of a million input tokens [USD], for the cost in run.json")
    output_price: float = Field(ge=0, description="price of a million output tokens [USD]")

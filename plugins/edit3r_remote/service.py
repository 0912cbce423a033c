"""What is asked of an image service and what it answers, free of any one service's words."""

import os
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

from pydantic import Field

from edit3r.contract.errors import Edit3rError, MissingDependencyError, RunError
from edit3r.contract.settings import USER_ONLY, Settings
from edit3r.kit.service import quoted

MAX_TOKENS = 10**12


class RemoteSettings(Settings):
    """Which service answers, how patiently, and what its tokens cost.

    Keys come from the environment alone.
    """

    model: str
    """the service's name of the model"""
    base_url: str = Field("", json_schema_extra=USER_ONLY)
    """address of a compatible service; empty: the service's own"""
    timeout_s: float = Field(180.0, gt=0, le=3600)
    """time limit of one attempt [s]"""
    attempts: int = Field(4, ge=1, le=20)
    """tries per view when the service is busy or fails (429, 5xx)"""
    concurrent: int = Field(2, ge=1, le=32)
    """views sent at the same time"""
    cache: str = "~/.cache/edit3r/remote"
    """folder of paid answers, used again for equal requests; empty: keep none"""
    input_price: float = Field(ge=0)
    """price of a million input tokens [USD], for the cost in run.json"""
    output_price: float = Field(ge=0)
    """price of a million output tokens [USD]"""

    @property
    def deadline(self) -> float:
        """Time limit of one view [s]: all attempts, and at most a minute before each further."""
        return self.attempts * self.timeout_s + 60 * (self.attempts - 1)


@dataclass(frozen=True)
class Request:
    """One view to edit."""

    name: str  # of the view, for messages
    prompt: str
    seed: int
    image: bytes  # PNG of exactly `size`
    mask: bytes | None  # PNG of `size`, transparent where the image may change
    size: tuple[int, int]  # (height, width) [pixels], one that the service offers


@dataclass(frozen=True)
class ServiceAnswer:
    """What came back, paid for."""

    image: bytes  # an encoded image, not yet checked
    input_tokens: int  # 0 where the service gave no count
    output_tokens: int

    def __post_init__(self) -> None:
        """Take what is no count as 0: a wrong bill must not cost the image that was paid for."""
        for name in ("input_tokens", "output_tokens"):
            count = getattr(self, name)
            if type(count) is not int or not 0 <= count < MAX_TOKENS:
                object.__setattr__(self, name, 0)


class ImageService(ABC):
    """A client of one image service; safe to use from several threads."""

    label: str  # name in messages
    # of the environment, the first that is set holds the key
    variables: tuple[str, ...]

    def __init__(self, settings: RemoteSettings) -> None:
        """Raises MissingDependencyError where no variable holds a key."""
        self.settings = settings
        self.key = ""
        for name in self.variables:
            self.key = self.key or os.environ.get(name, "").strip()
        if not self.key:
            raise MissingDependencyError(
                f"{self.label} needs an API key; set the environment variable "
                f"{' or '.join(self.variables)}."
            )

    @abstractmethod
    def send(self, request: Request) -> ServiceAnswer:
        """Ask and wait, with the attempts of the settings. Raises PromptError for a refusal."""

    def without_key(self, answer: ServiceAnswer) -> ServiceAnswer:
        """The answer, in which nothing is the key: its bytes may be shown and kept."""
        return replace(answer, image=answer.image.replace(self.key.encode(), b"***"))

    def quote(self, words: object) -> str:
        """Put the service's words on one line, shortened, without the key."""
        return quoted(str(words).replace(self.key, "***"))

    def failure(self, status: int, words: object, request: Request) -> Edit3rError:
        """The error for an HTTP status that further attempts did not cure."""
        reply = self.quote(words)
        if status in (401, 403) or "api key not valid" in reply.lower():
            # A service may repeat parts of a key that it does not know.
            why = "" if status == 401 else f" ({reply})"
            return MissingDependencyError(
                f"{self.label}: the service does not accept the key in "
                f"{' or '.join(self.variables)}{why}."
            )
        if 300 <= status < 400:
            return RunError(
                f"{self.label}: its address redirects elsewhere, which is not followed (status "
                f"{status}); give the right one as editor.base_url."
            )
        if status == 429:
            return RunError(
                f"{self.label} is over its rate limit or budget after {self.settings.attempts} "
                f"tries for {request.name} ({reply}); wait, or lower editor.concurrent."
            )
        return RunError(
            f"{self.label} failed on {request.name} with status {status}: {reply}"
        )

"""What is asked of an image service and what it answers, free of any one service's words, and the
answers kept.
"""

import hashlib
import json
import os
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import Field

from edit3r.config import USER_ONLY, Settings
from edit3r.errors import MissingDependencyError
from edit3r.io.atomic import atomic_write

MOST_TOKENS = 10**12
QUOTE_LENGTH = 300  # characters of a service's words repeated in an error


class RemoteSettings(Settings):
    """Which service answers, how patiently, and what its tokens cost. Keys come from the
    environment alone.
    """

    model: str = Field(description="the service's name of the model")
    base_url: str = Field(
        "",
        description="address of a compatible service; empty: the service's own",
        json_schema_extra=USER_ONLY,
    )
    timeout_s: float = Field(
        180.0, gt=0, le=3600, description="time limit of one attempt [s]"
    )
    attempts: int = Field(
        4,
        ge=1,
        le=20,
        description="tries per view when the service is busy or fails (429, 5xx)",
    )
    concurrent: int = Field(2, ge=1, le=32, description="views sent at the same time")
    cache: str = Field(
        "~/.cache/edit3r/remote",
        description="folder of paid answers, used again for equal requests; empty: keep none",
    )
    input_price: float = Field(
        ge=0,
        description="price of a million input tokens [USD], for the cost in run.json",
    )
    output_price: float = Field(
        ge=0, description="price of a million output tokens [USD]"
    )


@dataclass(frozen=True)
class Request:
    """One view to edit."""

    name: str  # of the view, for messages
    prompt: str
    seed: int
    image: bytes  # PNG of exactly `size`
    mask: (
        bytes | None
    )  # PNG of `size`, transparent where the image may change; None: everywhere
    size: tuple[int, int]  # (height, width) [pixels], one that the service offers


@dataclass(frozen=True)
class Answer:
    """What came back, paid for."""

    image: bytes  # an encoded image, not yet checked
    input_tokens: int  # 0 where the service gave no count
    output_tokens: int

    def __post_init__(self) -> None:
        """Take what is no count as 0: a wrong bill must not cost the picture that was paid for."""
        for name in ("input_tokens", "output_tokens"):
            count = getattr(self, name)
            plain = (
                isinstance(count, int)
                and not isinstance(count, bool)
                and 0 <= count < MOST_TOKENS
            )
            object.__setattr__(self, name, count if plain else 0)


class ImageService(ABC):
    """A client of one image service; safe to use from several threads."""

    label: str  # name in messages
    key: str  # the secret; never printed

    @abstractmethod
    def send(self, request: Request) -> Answer:
        """Ask and wait, with the retries the settings allow. Raises PromptError for a refusal, else
        RunError.
        """

    def without_key(self, answer: Answer) -> Answer:
        """The answer, in which nothing is the key: its bytes may be shown and kept."""
        return replace(answer, image=answer.image.replace(self.key.encode(), b"***"))

    def quote(self, words: object) -> str:
        """Put the service's words on one line, shortened, without the key."""
        line = " ".join(str(words).split()).replace(self.key, "***")
        return line if len(line) <= QUOTE_LENGTH else f"{line[:QUOTE_LENGTH]}..."


def key_from_environment(editor: str, *variables: str) -> str:
    """Read the key from the first of `variables` that is set; raises MissingDependencyError when
    none is.
    """
    key = next(
        (
            os.environ[name].strip()
            for name in variables
            if os.environ.get(name, "").strip()
        ),
        "",
    )
    if not key:
        names = " or ".join(variables)
        raise MissingDependencyError(
            f"{editor} needs an API key; set the environment variable {names}."
        )
    return key


class AnswerCache:
    """Every paid answer on disk, so that a broken run goes on without paying twice; no folder:
    nothing is kept.
    """

    def __init__(self, folder: str) -> None:
        self.folder = Path(folder).expanduser() if folder else None

    def key(self, request: Request, asked: dict[str, Any]) -> str:
        """Hash all that decides an answer; `asked` holds the service, model and settings sent with
        the request.
        """
        words = {
            "prompt": request.prompt,
            "seed": request.seed,
            "size": request.size,
            **asked,
        }
        digest = hashlib.sha256(json.dumps(words, sort_keys=True).encode())
        for part in (request.image, request.mask or b""):
            digest.update(hashlib.sha256(part).digest())
        return digest.hexdigest()

    def find(self, key: str) -> Answer | None:
        """Look up the answer kept under `key`; one that cannot be read counts as absent."""
        if self.folder is None:
            return None
        try:
            image = self._path(key, "image").read_bytes()
            usage = json.loads(self._path(key, "json").read_text(encoding="utf-8"))
            return Answer(image, usage["input_tokens"], usage["output_tokens"])
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def keep(self, key: str, answer: Answer, accepted: bool = True) -> Path | None:
        """Write an answer; one that was not accepted is kept beside the others for the user, never
        found again.
        """
        if self.folder is None:
            return None
        self.folder.mkdir(parents=True, exist_ok=True)
        if not accepted:
            return self._write(self._path(key, "rejected"), answer.image)
        usage = {
            "input_tokens": answer.input_tokens,
            "output_tokens": answer.output_tokens,
        }
        path = self._write(self._path(key, "image"), answer.image)
        self._write(self._path(key, "json"), json.dumps(usage).encode())
        return path

    def _path(self, key: str, ending: str) -> Path:
        return self.folder / f"{key}.{ending}"

    def _write(self, path: Path, content: bytes) -> Path:
        with atomic_write(path) as partial:
            partial.write_bytes(content)
        return path

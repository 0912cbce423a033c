"""What is asked of an image service and what it answers, free of any one service's words."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

from edit3r.errors import MissingDependencyError

QUOTE_LENGTH = 300  # characters of a service's words repeated in an error


@dataclass(frozen=True)
class Request:
    """One view to edit."""

    name: str  # of the view, for messages
    prompt: str
    seed: int
    picture: bytes  # PNG of exactly `size`
    mask: bytes | None  # PNG of `size`, transparent where the picture may change; None: everywhere
    size: tuple[int, int]  # (height, width) [pixels], one that the service offers


@dataclass(frozen=True)
class Answer:
    """What came back, paid for."""

    picture: bytes  # an encoded picture, not yet checked
    input_tokens: int
    output_tokens: int


class ImageService(ABC):
    """A client of one image service; safe to use from several threads."""

    label: str  # name in messages
    key: str  # the secret; never printed

    @abstractmethod
    def send(self, request: Request) -> Answer:
        """Ask and wait, with the retries the settings allow. Raises PromptError for a refusal, else RunError."""

    def quote(self, words: object) -> str:
        """The service's words on one line, shortened, without the key."""
        line = " ".join(str(words).split()).replace(self.key, "***")
        return line if len(line) <= QUOTE_LENGTH else f"{line[:QUOTE_LENGTH]}..."


def missing_key(editor: str, *variables: str) -> MissingDependencyError:
    """The error for an absent key."""
    names = " or ".join(variables)
    return MissingDependencyError(f"{editor} needs an API key; set the environment variable {names}.")

"""Every paid answer on disk, so that a broken run goes on without paying twice."""

import hashlib
import json
from pathlib import Path
from typing import Any

from edit3r.kit.files.atomic import atomic_write
from edit3r.kit.files.names import expanded
from edit3r_remote.service import Request, ServiceAnswer


class AnswerCache:
    """Answers by a hash of their request; without a folder, nothing is kept."""

    def __init__(self, folder: str) -> None:
        self.folder = expanded(folder) if folder else None

    def key(self, request: Request, asked: dict[str, Any]) -> str:
        """Hash all that decides an answer; `asked` is what else the service was told."""
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

    def find(self, key: str) -> ServiceAnswer | None:
        """Look up the answer kept under `key`; one that cannot be read counts as absent."""
        if self.folder is None:
            return None
        try:
            image = (self.folder / f"{key}.image").read_bytes()
            usage = json.loads((self.folder / f"{key}.json").read_bytes())
            return ServiceAnswer(image, usage["input_tokens"], usage["output_tokens"])
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def keep(self, key: str, answer: ServiceAnswer) -> None:
        """Write an answer. Raises OSError or InputError where that is not possible."""
        usage = {
            "input_tokens": answer.input_tokens,
            "output_tokens": answer.output_tokens,
        }
        self.write(f"{key}.image", answer.image)
        self.write(f"{key}.json", json.dumps(usage).encode())

    def write(self, name: str, content: bytes) -> Path | None:
        """Write one file of the folder and return its path; None without a folder."""
        if self.folder is None:
            return None
        self.folder.mkdir(parents=True, exist_ok=True)
        with atomic_write(self.folder / name) as partial:
            partial.write_bytes(content)
        return self.folder / name

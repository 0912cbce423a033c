"""Keep every paid answer on disk, so that a broken run goes on without paying twice."""

import hashlib
import json
import os
import tempfile
from pathlib import Path
from typing import Any

from edit3r_remote.service import Answer, Request


class AnswerCache:
    """Answers by picture, mask, prompt, seed, model and settings; with an empty folder name nothing is kept."""

    def __init__(self, folder: str) -> None:
        self.folder = Path(folder).expanduser() if folder else None

    def key(self, request: Request, asked: dict[str, Any]) -> str:
        """Hash of all that decides an answer; `asked` holds the service, model and settings sent with the request."""
        words = {"prompt": request.prompt, "seed": request.seed, "size": request.size, **asked}
        digest = hashlib.sha256(json.dumps(words, sort_keys=True).encode())
        for part in (request.picture, request.mask or b""):
            digest.update(hashlib.sha256(part).digest())
        return digest.hexdigest()

    def find(self, key: str) -> Answer | None:
        """The answer kept under `key`; one that cannot be read counts as absent."""
        if self.folder is None:
            return None
        try:
            picture = self._path(key, "image").read_bytes()
            usage = json.loads(self._path(key, "json").read_text(encoding="utf-8"))
            return Answer(picture, usage["input_tokens"], usage["output_tokens"])
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def keep(self, key: str, answer: Answer, accepted: bool = True) -> Path | None:
        """Write an answer; one that was not accepted is kept beside the others for the user, never found again."""
        if self.folder is None:
            return None
        self.folder.mkdir(parents=True, exist_ok=True)
        if not accepted:
            return self._write(self._path(key, "rejected"), answer.picture)
        usage = {"input_tokens": answer.input_tokens, "output_tokens": answer.output_tokens}
        path = self._write(self._path(key, "image"), answer.picture)
        self._write(self._path(key, "json"), json.dumps(usage).encode())
        return path

    def _path(self, key: str, ending: str) -> Path:
        return self.folder / f"{key}.{ending}"

    def _write(self, path: Path, content: bytes) -> Path:
        """Write beside and move into place, so that a run that is killed leaves no half file."""
        handle, temporary = tempfile.mkstemp(dir=self.folder)
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.replace(temporary, path)
        return path

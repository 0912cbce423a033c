"""A language model behind any OpenAI-compatible address: a local server's, or a service's."""

import os
from dataclasses import dataclass

from edit3r.errors import MissingDependencyError, RunError

__all__ = ["KEY_VARIABLE", "LanguageModel"]

KEY_VARIABLE = "OPENAI_API_KEY"


@dataclass(frozen=True)
class LanguageModel:
    """Asked once a scene. The key comes from the environment only; local servers want none."""

    address: str  # such as http://localhost:8000/v1
    name: str
    timeout_s: float = 120.0
    attempts: int = 3

    def ask(self, system: str, request: str) -> str:
        """The model's answer at temperature 0. Raises RunError when none comes."""
        try:
            import openai
        except ImportError:
            raise MissingDependencyError(
                '--llm needs the openai client; install with: pip install "edit3r[bench]"'
            ) from None
        client = openai.OpenAI(
            api_key=os.environ.get(KEY_VARIABLE, "").strip() or "none",
            base_url=self.address,
            timeout=self.timeout_s,
            max_retries=self.attempts - 1,
        )
        messages = [{"role": "system", "content": system}, {"role": "user", "content": request}]
        try:
            answer = client.chat.completions.create(model=self.name, messages=messages, temperature=0)
        except openai.OpenAIError as error:
            raise RunError(f"language model {self.name} at {self.address}: {' '.join(str(error).split())}") from None
        text = answer.choices[0].message.content if answer.choices else None
        if not text:
            raise RunError(f"language model {self.name} at {self.address} gave an empty answer.")
        return text

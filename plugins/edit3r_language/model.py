"""Readers that ask a language model: behind an address, or on this machine."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

from pydantic import Field

from edit3r.contract.errors import MissingDependencyError, RunError
from edit3r.contract.instructions import Instruction, Target
from edit3r.contract.interfaces import Reader
from edit3r.contract.reporting import note
from edit3r.contract.settings import USER_ONLY, Settings
from edit3r.contract.torch_state import require_device
from edit3r.kit.service import CHAT_KEY, ChatModel, quoted
from edit3r.kit.weights.load import (
    ChosenWeights,
    foreign,
    identity,
    load_pretrained,
    out_of_memory_told,
)
from edit3r_language.answers import instructions_of_answer, system_prompt
from edit3r_language.grammar import GrammarReader

Message = dict[str, str]
MOST_RETURNED = (
    10_000  # characters of a malformed answer that go back: ten times a long one
)


class ModelSettings(Settings):
    """How often a model may try."""

    attempts: int = Field(2, ge=1, le=10)
    """answers of another form that are sent back, at most"""


class AskingReader(Reader, ABC):
    """Asks for instructions as JSON, and sends a malformed answer back with what is wrong."""

    abilities = GrammarReader.abilities
    settings: ModelSettings
    who: str  # in messages

    @abstractmethod
    def ask(self, messages: Sequence[Message]) -> str:
        """The model's answer. Raises RunError where none comes."""

    def read(self, prompt: str) -> tuple[Instruction, ...]:
        messages = [
            {"role": "system", "content": system_prompt()},
            {"role": "user", "content": prompt},
        ]
        answer = why = ""
        for _ in range(self.settings.attempts):
            answer = self.ask(messages)
            try:
                return instructions_of_answer(answer, prompt)
            except ValueError as error:
                why = str(error)
            messages += [
                {"role": "assistant", "content": answer[:MOST_RETURNED]},
                {"role": "user", "content": f"That cannot be used: {why}. Try again."},
            ]
        raise RunError(
            f"{self.who} gave no instructions for {prompt[:80]!r}: {why} ({quoted(answer)}); say "
            "it otherwise, or leave --reader out."
        )

    def read_target(self, words: str) -> Target:
        return self.read(f"remove {words}")[0].target


class ServiceReader(AskingReader):
    """A model of OpenAI's, or of any server that speaks its chat completions."""

    class Settings(ModelSettings):
        model: str = "gpt-4.1-mini"
        """the service's name of the model"""
        base_url: str = Field("", json_schema_extra=USER_ONLY)
        """address of a compatible service, which may want no key; empty: OpenAI's"""
        timeout_s: float = Field(60.0, gt=0, le=3600)
        """time limit of one answer [s]"""

    settings: Settings

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self.who = f"language model {settings.model!r}"
        self._model = ChatModel(
            settings.model,
            settings.base_url,
            settings.timeout_s,
            "try later, raise reader.timeout_s, or leave --reader out",
        )
        if not self._model.key and not settings.base_url:
            raise MissingDependencyError(
                f"reader 'model' needs an API key; set the environment variable {CHAT_KEY}, or "
                "give a server that wants none: --set reader.base_url=http://localhost:8000/v1."
            )

    def ask(self, messages: Sequence[Message]) -> str:
        note("reader.model", self.settings.model)
        return self._model.ask(messages, response_format={"type": "json_object"})


class LocalReader(AskingReader):
    """A model on this machine, through transformers; the most likely answer, so no chance."""

    class Settings(ModelSettings):
        model: str
        """id of a chat model on the hub, or a saved folder"""
        revision: str = ""
        """branch, tag or commit of the model; empty: the newest"""
        local_files_only: bool = False
        """never download"""
        device: str = "cpu"
        """where it runs: cpu, cuda, ..."""
        max_tokens: int = Field(1000, ge=1, le=20000)
        """tokens of an answer, at most"""

    settings: Settings

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self.who = f"language model {settings.model!r}"
        self._loaded: tuple[Any, Any] | None = None

    def ask(self, messages: Sequence[Message]) -> str:
        network, tokenizer = self._model()
        text = _as_text(tokenizer, messages)
        tokens = tokenizer(text, return_tensors="pt", add_special_tokens=False)
        tokens = tokens.to(network.device)
        advice = "use a smaller model, or leave --reader out"
        with out_of_memory_told("reading the sentence", advice):
            answer = network.generate(
                **tokens,
                do_sample=False,
                max_new_tokens=self.settings.max_tokens,
                pad_token_id=tokenizer.eos_token_id,
            )
        new = answer[0, tokens["input_ids"].shape[1] :]
        return tokenizer.decode(new, skip_special_tokens=True)

    def _model(self) -> tuple[Any, Any]:
        if self._loaded is None:
            chosen = self.settings
            weights = ChosenWeights(
                chosen.model,
                "reader.model",
                chosen.revision,
                local_files_only=chosen.local_files_only,
            )
            device = require_device(chosen.device, "reader.device")
            names = ("AutoModelForCausalLM", "AutoTokenizer")
            classes = (foreign("transformers", name) for name in names)
            network, tokenizer = (load_pretrained(one, weights) for one in classes)
            self._loaded = network.to(device).eval(), tokenizer
            note("reader.weights", identity(weights))
        return self._loaded


def _as_text(tokenizer: Any, messages: Sequence[Message]) -> str:
    """The talk as the model was trained to see it; without such a form, line by line."""
    if tokenizer.chat_template:
        return tokenizer.apply_chat_template(
            list(messages), tokenize=False, add_generation_prompt=True
        )
    lines = [f"{one['role']}: {one['content']}" for one in messages]
    return "\n".join((*lines, "assistant: "))

"""Services over HTTP: no answer takes longer, and none is larger, than it may."""

import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, TimeoutError as WaitedTooLong
from dataclasses import dataclass
from typing import Any, TypeVar

from edit3r.contract.errors import MissingDependencyError, RunError

MAX_ANSWER = 1 << 26
"""Largest answer that is read [bytes]; an image of 16 megapixels has about half of that."""

END = "edit3r_end"
"""Extension of a request: when its answer must be complete, on the monotonic clock [s]."""

CHAT_KEY = "OPENAI_API_KEY"
MAX_QUOTE = 300  # characters of a service's words that an error repeats

Found = TypeVar("Found")


def within(seconds: float, call: Callable[[], Found]) -> Found:
    """Return `call()`. Raises TimeoutError after `seconds`, whatever the call waits for.

    It then goes on in a thread that does not keep the program from ending.
    """
    future: Future[Found] = Future()

    def work() -> None:
        try:
            future.set_result(call())
        except BaseException as error:
            future.set_exception(error)

    threading.Thread(target=work, daemon=True).start()
    try:
        return future.result(seconds)
    except WaitedTooLong:
        raise TimeoutError(f"no answer within {seconds:g} s") from None


@dataclass(frozen=True)
class ChatModel:
    """A language model behind OpenAI's chat completions, of theirs or of a compatible server.

    Its key comes from the environment alone (OPENAI_API_KEY); a server of one's own may want none.
    """

    name: str
    address: str = ""  # such as http://localhost:8000/v1; "": OpenAI's
    seconds: float = 60.0  # time limit of one answer
    advice: str = "try later"  # what else to do where none comes

    @property
    def key(self) -> str:
        return os.environ.get(CHAT_KEY, "").strip()

    def ask(self, messages: Sequence[Any], **more: Any) -> str:
        """The answer at temperature 0. Raises RunError where none comes, MissingDependencyError
        without the library `openai`.
        """
        try:
            import openai
        except ImportError:
            raise MissingDependencyError(
                "a language model needs the openai client; install with: "
                'pip install "edit3r[openai]"'
            ) from None
        who = f"language model {self.name!r}"

        def answer() -> Any:
            client = openai.OpenAI(
                api_key=self.key or "none",
                base_url=self.address or None,
                http_client=bounded_client(self.seconds),
                timeout=self.seconds,
                max_retries=1,
            )
            given: Any = list(messages)
            return client.chat.completions.create(
                model=self.name, messages=given, temperature=0, **more
            )

        try:
            found = within(2 * self.seconds, answer)
        # an SDK and its HTTP library raise dozens of types; their texts may hold the key
        except Exception as error:
            words = quoted(str(error).replace(self.key or "\0", "***"))
            raise RunError(
                f"{who} gave no answer ({type(error).__name__}: {words}); {self.advice}."
            ) from None
        text = found.choices[0].message.content if found.choices else None
        if not text:
            raise RunError(f"{who} gave an empty answer; try again.")
        return text.replace(self.key or "\0", "***")


def quoted(text: str) -> str:
    """A stranger's words on one line, shortened."""
    line = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    return line if len(line) <= MAX_QUOTE else f"{line[:MAX_QUOTE]}..."


def bounded_client(seconds: float) -> Any:
    """An `httpx2.Client` for the libraries `openai` and `google-genai`.

    An answer that is not complete after `seconds`, or breaks off, raises a timeout or a connection
    error, which these libraries try again; one of more than MAX_ANSWER bytes raises OSError. No
    redirect is followed: it would carry key and photo to another host.
    """
    import httpx2

    class Bounded(httpx2.SyncByteStream):
        def __init__(self, stream: Any, end: float) -> None:
            self.stream = stream
            self.end = end

        def __iter__(self) -> Iterator[bytes]:
            return _bounded_chunks(self.stream, self.end)

        def close(self) -> None:
            self.stream.close()

    def begin(request: Any) -> None:
        request.extensions[END] = time.monotonic() + seconds

    def receive(response: Any) -> None:
        # Unpacked, a small answer can fill the memory.
        if response.headers.get("content-encoding", "identity") != "identity":
            raise OSError("the answer is compressed, which was not asked for")
        response.stream = Bounded(response.stream, response.request.extensions[END])

    return httpx2.Client(
        timeout=seconds,
        follow_redirects=False,
        headers={"Accept-Encoding": "identity"},
        event_hooks={"request": [begin], "response": [receive]},
    )


def _bounded_chunks(stream: Any, end: float) -> Iterator[bytes]:
    """The chunks of an answer, until there are too many or it is too late."""
    import httpx2

    size = 0
    try:
        for chunk in stream:
            size += len(chunk)
            if size > MAX_ANSWER:
                raise OSError(f"the answer is larger than {MAX_ANSWER >> 20} MiB")
            if time.monotonic() > end:
                raise httpx2.ReadTimeout("the answer came too slowly")
            yield chunk
    except (httpx2.ReadError, httpx2.RemoteProtocolError) as error:
        raise httpx2.ConnectError(f"the answer broke off ({error})") from None

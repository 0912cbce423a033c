"""Services over HTTP: no answer takes longer, and none is larger, than it may."""

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, TimeoutError as WaitedTooLong
from typing import Any, TypeVar

MAX_ANSWER = 1 << 26
"""Largest answer that is read [bytes]; an image of 16 megapixels has about half of that."""

END = "edit3r_end"
"""Extension of a request: when its answer must be complete, on the monotonic clock [s]."""

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


def bounded_client(seconds: float) -> Any:
    """An `httpx2.Client` for the libraries `openai` and `google-genai`.

    An answer that is not complete after `seconds`, or breaks off, raises a timeout or a connection
    error, which these libraries try again; one of more than MAX_ANSWER bytes raises OSError.
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
        follow_redirects=True,
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

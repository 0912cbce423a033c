"""Send views to a service, several at a time, and account for what each cost."""

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from jaxtyping import Float
from torch import Tensor

from edit3r.contract.types import EditRequest, Views
from edit3r.errors import Edit3rError, InputError, PromptError, RunError
from edit3r.reporting import note, progress, warn
from edit3r_remote.frames import Frame, decode, encode_mask, encode_png
from edit3r_remote.service import (
    Answer,
    AnswerCache,
    ImageService,
    RemoteSettings,
    Request,
)


@dataclass(frozen=True)
class ViewResult:
    """One edited view and its bill."""

    image: Float[Tensor, "3 height width"]
    remark: str  # for the user; '' if nothing
    cached: bool
    seconds: float  # until the answer was there, retries included
    answer: Answer


class Dispatcher:
    """Edits views through `service`; `asked` is what, besides picture and prompt, decides an
    answer.
    """

    def __init__(
        self, service: ImageService, settings: RemoteSettings, asked: dict[str, Any]
    ) -> None:
        self.service, self.settings, self.asked = service, settings, asked
        self.cache = AnswerCache(settings.cache)

    def edit(
        self,
        views: Views,
        request: EditRequest,
        offered: Sequence[tuple[int, int]],
        send_masks: bool,
    ) -> Views:
        """Edit every view with something to change, sent as large as one of the sizes `offered`."""
        if not request.prompt.strip():
            raise PromptError(
                f"{self.service.label} needs an instruction; give one with --prompt."
            )
        frame = Frame.around(views.image_size, offered)
        jobs = {
            index: self._request(views, request, frame, index, send_masks)
            for index in range(views.images.shape[0] * views.count)
            if request.masks is None or request.masks.flatten(0, 1)[index].any()
        }
        results = self._send_all(jobs, frame)
        images = views.images.flatten(0, 1).clone()
        for index, result in results.items():
            images[index] = result.image.to(images)
        self._account(jobs, results)
        return replace(views, images=images.view_as(views.images))

    def _request(
        self,
        views: Views,
        request: EditRequest,
        frame: Frame,
        index: int,
        send_masks: bool,
    ) -> Request:
        view = index % views.count
        name = views.names[view] if views.names else f"view {view}"
        image = encode_png(
            frame.enclose(views.images.flatten(0, 1)[index].cpu().float())
        )
        mask = None
        if send_masks and request.masks is not None:
            mask = encode_mask(
                frame.enclose(request.masks.flatten(0, 1)[index][None].cpu().float())[0]
            )
        return Request(name, request.prompt, request.seed, image, mask, frame.size)

    def _send_all(
        self, jobs: dict[int, Request], frame: Frame
    ) -> dict[int, ViewResult]:
        """Collect all answers, or raise the first error once every view already sent has its answer
        in the cache.
        """
        results: dict[int, ViewResult] = {}
        errors: list[Edit3rError] = []
        text = f"asking {self.service.label}"
        progress(text, 0, len(jobs))
        with ThreadPoolExecutor(self.settings.concurrent) as pool:
            futures = {
                pool.submit(self._answer, job, frame): index
                for index, job in jobs.items()
            }
            for future in as_completed(futures):
                if future.cancelled():
                    continue
                try:
                    results[futures[future]] = future.result()
                except Edit3rError as error:
                    errors.append(error)
                    for waiting in futures:
                        waiting.cancel()
                progress(text, len(results), len(jobs))
        if errors:
            raise type(errors[0])(f"{errors[0]}{self._kept(results, jobs)}") from None
        return dict(sorted(results.items()))

    def _kept(self, results: dict[int, ViewResult], jobs: dict[int, Request]) -> str:
        if not results or self.cache.folder is None:
            return ""
        return f" {len(results)} of {len(jobs)} views have their answer in {self.cache.folder} and cost nothing again."

    def _answer(self, request: Request, frame: Frame) -> ViewResult:
        """Get one view from the cache, else from the service."""
        key = self.cache.key(request, self.asked)
        started = time.perf_counter()
        answer = self.cache.find(key)
        cached = answer is not None
        answer = answer or self._ask(request)
        seconds = 0.0 if cached else time.perf_counter() - started
        try:
            image, remark = decode(answer.image, frame.size, request.name)
        except RunError as error:
            if cached:
                raise
            where, _ = self._keep(key, answer, accepted=False)
            raise RunError(
                f"{self.service.label}: {error}{f' It is kept as {where}.' if where else ''}"
            ) from None
        if not cached:
            _, problem = self._keep(key, answer)
            remark = " ".join(filter(None, (remark, problem)))
        return ViewResult(frame.extract(image), remark, cached, seconds, answer)

    def _keep(
        self, key: str, answer: Answer, accepted: bool = True
    ) -> tuple[Path | None, str]:
        """Where the answer was kept, or why it was not: a full disk must not cost the picture that
        was paid for.
        """
        try:
            return self.cache.keep(key, answer, accepted), ""
        except (OSError, InputError) as error:
            return None, f"the answer cannot be kept in editor.cache ({error})."

    def _ask(self, request: Request) -> Answer:
        try:
            return self.service.without_key(self.service.send(request))
        except Edit3rError:
            raise
        # an SDK and its HTTP library raise dozens of types; their texts may hold the key
        except Exception as error:
            words = self.service.quote(f"{type(error).__name__}: {error}")
            raise RunError(
                f"{self.service.label}: no usable answer for {request.name} ({words})."
            ) from None

    def _account(
        self, jobs: dict[int, Request], results: dict[int, ViewResult]
    ) -> None:
        """Note facts for `run.json`: time, tokens and cost of each view; a cached one cost nothing
        this time.
        """
        bills = [
            self._bill(jobs[index].name, result) for index, result in results.items()
        ]
        note("editor.views", bills)
        note("editor.cost_usd", round(sum(bill["cost_usd"] for bill in bills), 6))
        for remark in (result.remark for result in results.values() if result.remark):
            warn(f"{self.service.label}: {remark}")

    def _bill(self, name: str, result: ViewResult) -> dict[str, Any]:
        tokens = result.answer.input_tokens, result.answer.output_tokens
        cost = (
            tokens[0] * self.settings.input_price
            + tokens[1] * self.settings.output_price
        ) / 1e6
        return {
            "view": name,
            "from_cache": result.cached,
            "seconds": round(result.seconds, 3),
            "input_tokens": tokens[0],
            "output_tokens": tokens[1],
            "cost_usd": 0.0 if result.cached else round(cost, 6),
        }

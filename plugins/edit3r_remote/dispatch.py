"""Send views to a service, several at a time, and account for what each cost."""

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

from jaxtyping import Float
from torch import Tensor

from edit3r.contract.errors import Edit3rError, InputError, PromptError, RunError
from edit3r.contract.reporting import note, progress, warn
from edit3r.contract.types import EditRequest, Views
from edit3r.kit.service import within
from edit3r_remote.cache import AnswerCache
from edit3r_remote.frames import ServiceFrame, decode, encode_mask, encode_png
from edit3r_remote.service import ImageService, Request, ServiceAnswer


@dataclass(frozen=True)
class ViewResult:
    """One edited view and its bill."""

    image: Float[Tensor, "3 height width"]
    remark: str  # for the user; '' if nothing
    cached: bool
    seconds: float  # until the answer was there, retries included
    answer: ServiceAnswer


class Dispatcher:
    """Edits views through `service`.

    `asked` is what, besides image and prompt, decides an answer.
    """

    def __init__(self, service: ImageService, asked: dict[str, Any]) -> None:
        self.service = service
        self.settings = service.settings
        self.asked = asked
        self.cache = AnswerCache(service.settings.cache)

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
        frame = ServiceFrame.around(views.image_size, offered)
        images = views.images.flatten(0, 1).clone()
        masks: Sequence[Tensor | None] = [None] * len(images)
        if request.masks is not None:
            masks = list(request.masks.flatten(0, 1))
        jobs: dict[int, Request] = {}
        for index, (photo, mask) in enumerate(zip(images, masks)):
            if mask is not None and not mask.any():
                continue
            view = index % views.count
            jobs[index] = Request(
                name=views.called[view],
                prompt=request.prompt,
                seed=request.seed,
                image=encode_png(frame.enclose(photo.cpu().float())),
                mask=encode_mask(frame.enclose(mask[None].cpu().float()))
                if mask is not None and send_masks
                else None,
                size=frame.size,
            )
        results = self._send_all(jobs, frame)
        for index, result in results.items():
            images[index] = result.image.to(images)
        self._account(jobs, results)
        return replace(views, images=images.view_as(views.images))

    def _send_all(
        self, jobs: dict[int, Request], frame: ServiceFrame
    ) -> dict[int, ViewResult]:
        """Collect all answers.

        Raises the first error once every view already sent has its answer in the cache.
        """
        results: dict[int, ViewResult] = {}
        errors: list[Edit3rError] = []
        text = f"asking {self.service.label}"
        progress(text, 0, len(jobs))
        with ThreadPoolExecutor(self.settings.concurrent) as pool:
            futures = {
                pool.submit(self._result, job, frame): index
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
        if not errors:
            return dict(sorted(results.items()))
        kept = ""
        if results and self.cache.folder is not None:
            kept = (
                f" {len(results)} of {len(jobs)} views have their answer in {self.cache.folder} "
                "and will not be charged again."
            )
        raise type(errors[0])(f"{errors[0]}{kept}") from None

    def _result(self, request: Request, frame: ServiceFrame) -> ViewResult:
        """Get one view from the cache, else from the service."""
        key = self.cache.key(request, self.asked)
        answer = self.cache.find(key)
        if answer is not None:
            image, remark = decode(answer.image, frame.size, request.name)
            return ViewResult(frame.extract(image), remark, True, 0.0, answer)
        started = time.perf_counter()
        answer = self._ask(request)
        seconds = time.perf_counter() - started
        try:
            image, remark = decode(answer.image, frame.size, request.name)
        except RunError as error:
            where = None
            with suppress(OSError, InputError):
                where = self.cache.write(f"{key}.rejected", answer.image)
            kept = f" It is kept as {where}." if where else ""
            raise RunError(f"{self.service.label}: {error}{kept}") from None
        try:
            self.cache.keep(key, answer)
        except (OSError, InputError) as error:
            # A full disk must not cost the image that was paid for.
            remark += f" the answer could not be saved in editor.cache ({error})."
        return ViewResult(frame.extract(image), remark, False, seconds, answer)

    def _ask(self, request: Request) -> ServiceAnswer:
        try:
            answer = within(self.settings.deadline, lambda: self.service.send(request))
        except Edit3rError:
            raise
        # an SDK and its HTTP library raise dozens of types; their texts may hold the key
        except Exception as error:
            cause: BaseException = error
            while cause.__cause__ is not None:
                cause = cause.__cause__
            words = self.service.quote(f"{type(cause).__name__}: {cause}")
            raise RunError(
                f"{self.service.label}: no usable answer for {request.name} ({words}); try "
                "later, or raise editor.timeout_s."
            ) from None
        return self.service.without_key(answer)

    def _account(
        self, jobs: dict[int, Request], results: dict[int, ViewResult]
    ) -> None:
        """Note for `run.json` time, tokens and cost of each view; a cached one cost nothing."""
        bills: list[dict[str, Any]] = []
        for index, result in results.items():
            if result.remark:
                warn(f"{self.service.label}: {result.remark}")
            answer = result.answer
            cost = answer.input_tokens * self.settings.input_price
            cost += answer.output_tokens * self.settings.output_price
            bills.append(
                {
                    "view": jobs[index].name,
                    "from_cache": result.cached,
                    "seconds": round(result.seconds, 3),
                    "input_tokens": answer.input_tokens,
                    "output_tokens": answer.output_tokens,
                    "cost_usd": 0.0 if result.cached else round(cost / 1e6, 6),
                }
            )
        note("editor.views", bills)
        note("editor.cost_usd", round(sum(bill["cost_usd"] for bill in bills), 6))

"""The app in one process: its one page, and the addresses of its data, images and files."""

import io
import os
import sys
import urllib.parse
import webbrowser
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import (
    FileResponse,
    HTMLResponse,
    JSONResponse,
    PlainTextResponse,
    RedirectResponse,
    Response,
)
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from edit3r import default_registry
from edit3r.contract.errors import Edit3rError, InputError
from edit3r.kit.files.text import parse_json
from edit3r.kit.photos.decode import read_image
from edit3r_app import downloads, uploads
from edit3r_app.draft import MARK, Draft, read_draft
from edit3r_app.drawing import Drawing
from edit3r_app.essentials import Essentials
from edit3r_app.flights import film
from edit3r_app.guard import Connection, Guard
from edit3r_app.jobs import KINDS, JobsFolder
from edit3r_app.made_scenes import offered_scenes, photo_of
from edit3r_app.phone import phone_link
from edit3r_app.preview_service import PreviewService
from edit3r_app.runner import Runner
from edit3r_app.studio import Studio
from edit3r_app.wording import in_app

STATIC = Path(__file__).with_name("static")
THUMBNAIL = 320  # [pixels], longer side
MAX_MEGABYTES = uploads.MAX_BYTES >> 20
MAX_ASKED = 1 << 20  # bytes of what a page asks for, other than photos
PHOTO = ("state", "name")  # parts of the path of a photo
SANDBOX = (
    "sandbox allow-scripts allow-downloads; default-src 'unsafe-inline' 'unsafe-eval' data: blob:; "
    "frame-ancestors 'self'"
)
"""A run may come from a stranger: its page gets an origin of its own, from which nothing here can
be reached.
"""


def serve(
    folder: JobsFolder,
    *,
    host: str,
    port: int,
    token: str | None,
    root: str,
    size: int,
    start: str,
    show: bool,
) -> None:
    """Serve the app until it is interrupted; the browser opens `start`, below `root`."""
    path = root + start
    path = f"{path}?token={urllib.parse.quote(token)}" if token else path
    name = "localhost" if host == "127.0.0.1" else host
    address = f"http://{name}:{port}{path}"

    def ready() -> None:
        print(
            f"edit3r app: {address}\n  jobs are kept in {folder.root}\n  Ctrl-C ends it",
            flush=True,
        )
        app.state.studio.prepare()
        if show:
            webbrowser.open(address)

    app = make_app(
        folder, token=token, root=root, size=size, ready=ready, place=(host, port)
    )
    uvicorn.run(
        app,
        host=host,
        port=port,
        http=Connection,
        ws="none",
        log_level="warning",
        timeout_graceful_shutdown=2,
    )
    sys.stdout.flush()
    os._exit(0)  # whatever is still being read of photos


def make_app(
    folder: JobsFolder,
    *,
    token: str | None,
    size: int,
    root: str = "",
    ready: Callable[[], None] = lambda: None,
    place: tuple[str, int] = ("localhost", 0),
) -> Starlette:
    """The app with its queue, which runs while the app is up; `ready` is called when it is.

    `place` is the host and port that it listens on; `root` a path that a proxy serves it under.
    """
    runner = Runner(folder)
    previews = PreviewService(folder, default_registry(), size)

    @asynccontextmanager
    async def running(_: Starlette) -> AsyncIterator[None]:
        runner.start()
        ready()
        yield
        await run_in_threadpool(runner.stop)
        await run_in_threadpool(previews.sessions.close)

    guard = Middleware(Guard, token=token, root=root, max_bytes=uploads.MAX_SCENE_BYTES)
    refusals = {Edit3rError: refused, OSError: refused}
    studio = Studio(folder, runner, previews, Drawing(folder, default_registry()))
    app = Starlette(
        routes=Answers(studio, place, token, root).below_root(),
        middleware=[guard],
        exception_handlers=refusals,
        lifespan=running,
    )
    app.state.studio = studio
    return app


def refused(request: Request, error: Exception) -> Response:
    """What the user can act on, in a sentence; also of a disk that is full."""
    if isinstance(error, OSError):  # whose own words name folders
        return PlainTextResponse(f"the disk refused it: {error.strerror}.", 507)
    return PlainTextResponse(in_app(str(error)), 400)


class Answers:
    """Answers to all addresses."""

    def __init__(
        self, studio: Studio, place: tuple[str, int], token: str | None, root: str
    ) -> None:
        self.studio = studio
        self.place, self.token, self.root = place, token, root
        self.folder = studio.folder
        self.previews = studio.previews
        self.essentials = Essentials(studio.renew)

    def below_root(self) -> list[Route | Mount]:
        """All routes, and below the root path too: proxies may take it away, or leave it."""
        routes = self.routes()
        return [Mount(self.root, routes=routes), *routes] if self.root else routes

    def routes(self) -> list[Route | Mount]:
        studio, get, post = self.studio, _asked, _told
        return [
            Route("/", self.page),
            Route("/s/{scene}", self.page),
            Mount("/static", StaticFiles(directory=STATIC)),
            Route("/api/home", get(lambda: self.home())),
            Route("/api/scene/{scene}", get(studio.scene, at="")),
            Route("/api/look/{state}", get(studio.look)),
            Route("/api/suggestions/{state}/{name}", get(studio.suggestions)),
            Route("/api/verdict/{state}", get(studio.verdict)),
            Route("/api/settings/{state}", get(studio.settings)),
            Route("/api/files/{run}", get(studio.files)),
            post("/api/essentials", self.essentials.fetch, words=()),
            post("/api/made/{name}", studio.made, words=()),
            post("/api/draft/{state}", studio.change),
            post("/api/step/{state}", self.step),
            post("/api/go/{scene}", studio.go, words=("at", "say")),
            post("/api/object/{scene}", self.act),
            post("/api/draw/{run}", studio.draw),
            post("/api/cancel/{run}", studio.runner.cancel, words=()),
            post("/api/upright/{scene}", studio.turn_upright, words=("up",)),
            post("/api/remove/{scene}", studio.take_out, words=("photo",)),
            post("/api/delete/{scene}", studio.delete, words=()),
            post("/api/prepare/{run}", self.prepare, words=("file",)),
            post("/api/film/{run}", self.film),
            post("/api/phone", self.phone, words=("page",)),
            Route("/upload/{scene}", self.upload, methods=["POST"]),
            Route("/thumbnail/{scene}/{name}", self.thumbnail),
            Route("/made/{name}", self.made),
            Route("/photo/{state}/{name}", self.photo),
            Route("/overlay/{state}/{name}", self.overlay),
            Route("/pointed/{state}/{name}", self.pointed),
            Route("/edited/{state}/{name}", self.edited),
            Route("/suggestion/{state}/{name}/{number:int}", self.suggestion),
            Route("/candidate/{state}/{number:int}", self.candidate),
            Route("/image/{state}/{kind}/{name}", self.image),
            Route("/viewer/{run}", self.viewer),
            Route("/download/{run}/{what}", self.download),
        ]

    # ---- data ----

    def home(self) -> dict[str, Any]:
        self.studio.prepare()
        return {
            "scenes": self.studio.scenes(),
            "made": list(offered_scenes()),
            "essentials": self.essentials.state(),
            "most": {"photos": uploads.MAX_PHOTOS, "megabytes": MAX_MEGABYTES},
        }

    def step(self, state: str, asked: dict[str, Any]) -> dict[str, Any]:
        """The next larger candidate for 1, else the next smaller one."""
        return self.studio.step(state, 1 if asked.get("value") == 1 else -1)

    def act(self, scene: str, asked: dict[str, Any]) -> str:
        at = str(asked.pop("at", ""))
        return self.studio.act(scene, at, asked)

    def prepare(self, run: str, file: str) -> int:
        """Make a download, and return its size [bytes]."""
        return downloads.prepared(self.folder, run, file).stat().st_size

    def film(self, run: str, asked: dict[str, Any]) -> dict[str, Any]:
        """Make the video of a flight; returns its file and its size [bytes]."""
        made = film(
            self.folder,
            run,
            asked.get("keys"),
            default_registry(),
            self.previews.sessions.scene_of(run),
            bool(asked.get("mp4")),
        )
        return {"file": made.name, "bytes": made.stat().st_size}

    def phone(self, page: str) -> dict[str, Any]:
        return phone_link(*self.place, self.token, page)

    async def upload(self, request: Request) -> Response:
        scene = request.path_params["scene"]
        name, wanted = (
            urllib.parse.unquote(request.headers.get(key, ""))
            for key in ("x-name", "x-folder")
        )
        length = request.headers.get("content-length")
        size = int(length) if length else None
        is_new = scene == "-"
        if is_new:
            scene = self.folder.new_scene(wanted or uploads.title_of(name))
        self.folder.path(scene)
        try:
            await uploads.receive(self.folder, scene, name, size, request.stream())
        except BaseException as error:
            if is_new:
                uploads.discard(self.folder, scene)
            if isinstance(error, ClientDisconnect):
                return PlainTextResponse("broken off", 400)  # nobody reads it
            raise
        return PlainTextResponse(scene)

    def page(self, request: Request) -> Response:
        text = (STATIC / "index.html").read_text(encoding="utf-8")
        return HTMLResponse(text.replace('"/static/', f'"{self.root}/static/'))

    # ---- images and files ----

    def thumbnail(self, request: Request) -> Response:
        scene, name = _named(request, "scene", "name")
        photo = _there(self.folder.photos(scene).get(name))
        return _jpeg(_small(photo, photo.stat().st_mtime_ns))

    def made(self, request: Request) -> Response:
        photo = photo_of(*_named(request, "name"))
        return _jpeg(_small(photo, photo.stat().st_mtime_ns))

    def photo(self, request: Request) -> Response:
        shown = "shown" in request.query_params
        state, name = _named(request, *PHOTO)
        self.folder.path(state)
        return _jpeg(self.previews.photo(state, name, shown))

    def overlay(self, request: Request) -> Response:
        state, draft, name = self._drafted(request)
        line = "line" in request.query_params
        return _png(self.previews.overlay(state, draft, name, line))

    def edited(self, request: Request) -> Response:
        """The 2D edit of one photo, before anything is made."""
        found = "found" in request.query_params
        return _jpeg(self.previews.edited(*self._drafted(request), found))

    def suggestion(self, request: Request) -> Response:
        state, name = _named(request, *PHOTO)
        self.folder.path(state)
        return _jpeg(
            self.previews.suggestion(state, name, request.path_params["number"])
        )

    def pointed(self, request: Request) -> Response:
        """What is pointed at on one photo; with `mark`, as if that mark were made as well.

        With `made` it is being made, and may be kept already.
        """
        state, draft, name = self._drafted(request)
        mark = request.query_params.get("mark")
        if mark:
            made = _mark_of(mark)
            if draft.marks[-1:] != [made] or "made" not in request.query_params:
                draft.take(made)
        made_so = "made" in request.query_params
        line = (bool(mark) and not made_so) or "line" in request.query_params
        return _png(self.previews.pointed(state, draft, name, line=line))

    def candidate(self, request: Request) -> Response:
        state, number = request.path_params["state"], request.path_params["number"]
        self.folder.path(state)
        draft = read_draft(self.folder, state)
        return _jpeg(self.previews.candidate(state, draft, number))

    def _drafted(self, request: Request) -> tuple[str, Draft, str]:
        """The state, its draft and the photo that an address names."""
        state, name = _named(request, *PHOTO)
        self.folder.path(state)
        return state, read_draft(self.folder, state), name

    def image(self, request: Request) -> Response:
        state, kind, name = _named(request, "state", "kind", "name")
        if kind not in KINDS:
            raise InputError(f"{kind[:20]!r}: no images of that kind.")
        self.folder.job(state)
        return FileResponse(_there(self.folder.images(state, kind).get(name)))

    def viewer(self, request: Request) -> Response:
        """The page of a run's scene, made where the run did not write it.

        It is shown in a frame only, which our page keeps here: on its own it could lead away.
        """
        if request.headers.get("sec-fetch-dest") == "document":
            return RedirectResponse(f"{self.root}/", 303)
        run = request.path_params["run"]
        if self.folder.is_run(run):
            file = downloads.prepared(self.folder, run, downloads.VIEWER)
        else:
            file = self.previews.viewer(run)
        file = _there(file)
        policy = {"content-security-policy": SANDBOX}
        return FileResponse(file, media_type="text/html", headers=policy)

    def download(self, request: Request) -> Response:
        run, what = _named(request, "run", "what")
        file = downloads.prepared(self.folder, run, what)
        name = f"{run}-{what}"
        return FileResponse(file, media_type="application/octet-stream", filename=name)


def _named(request: Request, *names: str) -> tuple[str, ...]:
    return tuple(request.path_params[name] for name in names)


def _asked(call: Callable[..., Any], **defaults: str) -> Callable:
    """An answer in JSON to a question: parts of the path, and of the query with defaults."""

    def answer(request: Request) -> Response:
        query = request.query_params
        more = [query.get(name, default) for name, default in defaults.items()]
        return JSONResponse(call(*request.path_params.values(), *more))

    return answer


def _told(
    path: str, call: Callable[..., Any], words: Sequence[str] | None = None
) -> Route:
    """An address that is told an object of JSON: `call` is given the parts of the path, and the
    object or some `words` of it.
    """

    async def answer(request: Request) -> Response:
        content = b""
        async for chunk in request.stream():  # which may say nothing of its length
            content += chunk
            if len(content) > MAX_ASKED:
                raise InputError(f"more than {MAX_ASKED >> 20} MB of JSON.")
        try:
            asked = parse_json(content or b"{}")
        except ValueError as error:
            raise InputError(f"expected JSON ({error}).") from None
        if not isinstance(asked, dict):
            raise InputError("expected an object of JSON.")
        told = (
            [asked] if words is None else [str(asked.get(word, "")) for word in words]
        )
        done = await run_in_threadpool(call, *request.path_params.values(), *told)
        return JSONResponse(done)

    return Route(path, answer, methods=["POST"])


def _mark_of(text: str) -> Any:
    try:
        return MARK.validate_json(text[:4000])
    except ValueError:
        raise InputError("not a mark that can be made.") from None


def _there(file: Path | None) -> Path:
    """The file, where it is one and no link to another."""
    if file is None or not file.is_file() or file.is_symlink():
        raise InputError("no such image or file.")
    return file


def _jpeg(content: bytes) -> Response:
    return Response(content, media_type="image/jpeg")


def _png(content: bytes) -> Response:
    return Response(content, media_type="image/png")


@lru_cache(maxsize=512)
def _small(photo: Path, changed: int) -> bytes:
    image = read_image(photo, THUMBNAIL)
    image.thumbnail((THUMBNAIL, THUMBNAIL))
    content = io.BytesIO()
    image.save(content, "JPEG", quality=85)
    return content.getvalue()

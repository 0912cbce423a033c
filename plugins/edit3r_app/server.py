"""The parts of the app in one process, and the addresses of its images, uploads and downloads."""

import io
import logging
import urllib.parse
from functools import lru_cache
from pathlib import Path

from fastapi import Request
from fastapi.responses import FileResponse, PlainTextResponse, Response
from nicegui import app, ui

from edit3r import default_registry
from edit3r.contract.errors import Edit3rError, InputError
from edit3r.kit.photos.decode import read_image
from edit3r_app import downloads, uploads
from edit3r_app.draft import read_draft
from edit3r_app.guard import Guard
from edit3r_app.jobs import KINDS, JobsFolder
from edit3r_app.looking import Looker
from edit3r_app.pages import add_pages
from edit3r_app.pages.parts import Tab
from edit3r_app.runner import Runner

THUMBNAIL = 320  # [pixels], longer side
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
    size: int,
    start: str,
    show: bool,
) -> None:
    """Serve the app until it is interrupted; `start` is the path that the browser opens."""
    runner = Runner(folder)
    looker = Looker(folder, default_registry(), size)
    app.add_middleware(Guard, token=token, max_bytes=uploads.MAX_BYTES)
    app.add_static_files("/static", Path(__file__).with_name("static"))
    _add_routes(Answers(folder, looker))
    add_pages(Tab(folder, runner, looker))
    app.on_startup(runner.start)
    app.on_shutdown(runner.stop)
    logging.getLogger("nicegui").addFilter(_is_unexpected)
    path = f"{start}?token={urllib.parse.quote(token)}" if token else start
    name = "localhost" if host == "127.0.0.1" else host
    print(
        f"edit3r app: http://{name}:{port}{path}\n  jobs are kept in {folder.root}\n"
        "  Ctrl-C ends it",
        flush=True,
    )
    ui.run(
        host=host,
        port=port,
        title="edit3r",
        favicon="✏️",
        show=path if show else False,
        reload=False,
        show_welcome_message=False,
        reconnect_timeout=20,
    )


def _is_unexpected(record: logging.LogRecord) -> bool:
    """Whether a logged error is none of those that the page has told the user."""
    return not (record.exc_info and isinstance(record.exc_info[1], Edit3rError))


def _add_routes(answers: "Answers") -> None:
    app.add_exception_handler(Edit3rError, refused)
    app.add_exception_handler(OSError, refused)
    app.post("/upload/{scene}")(answers.upload)
    app.get("/thumbnail/{scene}/{name}")(answers.thumbnail)
    app.get("/marked/{state}/{name}")(answers.marked)
    app.get("/image/{state}/{kind}/{name}")(answers.image)
    app.get("/viewer/{run}")(answers.viewer)
    app.get("/download/{run}/{what}")(answers.download)


def refused(request: Request, error: Exception) -> Response:
    """What the user can act on, in a sentence; also of a disk that is full."""
    return PlainTextResponse(str(error), 400 if isinstance(error, Edit3rError) else 507)


class Answers:
    """Answers to all addresses that are no page."""

    def __init__(self, folder: JobsFolder, looker: Looker) -> None:
        self.folder = folder
        self.looker = looker

    async def upload(self, scene: str, request: Request) -> Response:
        name, wanted = (
            urllib.parse.unquote(request.headers.get(key, ""))
            for key in ("x-name", "x-folder")
        )
        length = request.headers.get("content-length")
        size = int(length) if length else None
        is_new = scene == "-"
        if is_new:
            scene = self.folder.new_scene(wanted or Path(name).stem)
        self.folder.path(scene)
        try:
            await uploads.receive(self.folder, scene, name, size, request.stream())
        except (Edit3rError, OSError):
            if is_new:
                uploads.discard(self.folder, scene)
            raise
        return PlainTextResponse(scene)

    def thumbnail(self, scene: str, name: str) -> Response:
        photo = _there(self.folder.photos(scene).get(name))
        content = _small(photo, photo.stat().st_mtime_ns)
        return Response(content, media_type="image/jpeg")

    def marked(self, state: str, name: str) -> Response:
        content = self.looker.image(state, read_draft(self.folder, state), name)
        return Response(content, media_type="image/jpeg")

    def image(self, state: str, kind: str, name: str) -> Response:
        if kind not in KINDS:
            raise InputError(f"{kind[:20]!r}: no images of that kind.")
        self.folder.job(state)
        return FileResponse(_there(self.folder.images(state, kind).get(name)))

    def viewer(self, run: str) -> Response:
        file = _there(self.folder.path(run) / "viewer.html")
        policy = {"content-security-policy": SANDBOX}
        return FileResponse(file, media_type="text/html", headers=policy)

    def download(self, run: str, what: str) -> Response:
        file = downloads.prepared(self.folder, run, what)
        return FileResponse(
            file, media_type="application/octet-stream", filename=f"{run}-{what}"
        )


def _there(file: Path | None) -> Path:
    """The file, where it is one and no link to another."""
    if file is None or not file.is_file() or file.is_symlink():
        raise InputError("no such image or file.")
    return file


@lru_cache(maxsize=512)
def _small(photo: Path, changed: int) -> bytes:
    image = read_image(photo)
    image.thumbnail((THUMBNAIL, THUMBNAIL))
    content = io.BytesIO()
    image.save(content, "JPEG", quality=85)
    return content.getvalue()

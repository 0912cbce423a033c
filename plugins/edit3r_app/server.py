"""The parts of the app in one process, and the addresses of its pictures, uploads and downloads."""

import io
import os
import tempfile
import urllib.parse
import zipfile
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from fastapi import Request
from fastapi.responses import (
    FileResponse,
    PlainTextResponse,
    Response,
    StreamingResponse,
)
from nicegui import app, ui

from edit3r.errors import Edit3rError, InputError
from edit3r.io.decode import read_image
from edit3r_app import page, uploads
from edit3r_app.choosing import Chooser, read_draft
from edit3r_app.guard import Guard
from edit3r_app.jobs import JobsFolder
from edit3r_app.runner import Runner

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
    runner, chooser = Runner(folder), Chooser(folder, size)
    app.add_middleware(Guard, token=token, most_bytes=uploads.MOST_BYTES)
    app.add_static_files("/static", Path(__file__).with_name("static"))
    _add_routes(folder, chooser)
    page.add_pages(folder, runner, chooser)
    app.on_startup(runner.start)
    app.on_shutdown(runner.stop)
    path = start + (
        f"{'&' if '?' in start else '?'}token={urllib.parse.quote(token)}"
        if token
        else ""
    )
    address = f"http://{'localhost' if host == '127.0.0.1' else host}:{port}{path}"
    print(
        f"edit3r app: {address}\n  jobs are kept in {folder.root}\n  Ctrl-C ends it",
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


def _add_routes(folder: JobsFolder, chooser: Chooser) -> None:
    @app.exception_handler(Edit3rError)
    async def refused(request: Request, error: Edit3rError) -> Response:
        return PlainTextResponse(str(error), 400)

    @app.post("/upload/{scene}")
    async def upload(scene: str, request: Request) -> Response:
        name, wish = (
            urllib.parse.unquote(request.headers.get(key, ""))
            for key in ("x-name", "x-folder")
        )
        length = request.headers.get("content-length")
        new = scene == "-"
        scene = folder.new_scene(wish or Path(name).stem) if new else scene
        folder.path(scene)
        try:
            await uploads.receive(
                folder, scene, name, int(length) if length else None, request.stream()
            )
        except Edit3rError:
            if new:
                uploads.discard(folder, scene)
            raise
        return PlainTextResponse(scene)

    @app.get("/thumbnail/{state}/{view}")
    def thumbnail(state: str, view: int) -> Response:
        photo = _one_of(folder.photos(state), view)
        return Response(
            _small(photo, photo.stat().st_mtime_ns), media_type="image/jpeg"
        )

    @app.get("/photo/{state}/{view}")
    def photo(state: str, view: int) -> Response:
        _one_of(folder.photos(state), view)
        return Response(
            chooser.picture(state, read_draft(folder, state), view),
            media_type="image/jpeg",
        )

    @app.get("/shown/{run}/{kind}/{view}")
    def shown(run: str, kind: str, view: int) -> Response:
        if kind not in ("inputs", "edited", "renders"):
            raise InputError(f"{kind[:20]!r}: no pictures of that kind.")
        return FileResponse(
            _one_of(folder.pictures(run, kind), view), media_type="image/png"
        )

    @app.get("/viewer/{run}")
    def viewer(run: str) -> Response:
        file = _one_of([folder.path(run) / "viewer.html"], 0)
        return FileResponse(
            file, media_type="text/html", headers={"content-security-policy": SANDBOX}
        )

    @app.get("/download/{run}/{what}")
    def download(run: str, what: str) -> Response:
        if what == "all.zip":
            named = urllib.parse.quote(f"{run}.zip")
            headers = {"content-disposition": f"attachment; filename*=UTF-8''{named}"}
            return StreamingResponse(
                _zipped(folder.path(run)), media_type="application/zip", headers=headers
            )
        if what not in page.DOWNLOADS:
            raise InputError(f"{what[:40]!r}: not a file of a run.")
        file = _one_of([folder.path(run) / what], 0)
        return FileResponse(
            file, media_type="application/octet-stream", filename=f"{run}-{what}"
        )


def _one_of(paths: list[Path], index: int) -> Path:
    if not (
        0 <= index < len(paths)
        and paths[index].is_file()
        and not paths[index].is_symlink()
    ):
        raise InputError("no such picture or file.")
    return paths[index]


@lru_cache(maxsize=512)
def _small(photo: Path, changed: int) -> bytes:
    image, content = read_image(photo), io.BytesIO()
    image.thumbnail((uploads.THUMBNAIL, uploads.THUMBNAIL))
    image.save(content, "JPEG", quality=85)
    return content.getvalue()


def _zipped(run: Path) -> Iterator[bytes]:
    """The files of a run that a person wants, as an archive; without its cache."""
    with tempfile.TemporaryFile() as file:
        with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
            for place, folders, names in os.walk(run):
                folders[:] = [name for name in folders if name != "cache"]
                for path in sorted(Path(place, name) for name in names):
                    if not path.is_symlink() and not path.name.startswith("."):
                        archive.write(path, Path(run.name) / path.relative_to(run))
        file.seek(0)
        while chunk := file.read(1 << 20):
            yield chunk

"""`edit3r app`: the whole way from photos to an edited scene in the browser."""

import argparse
import os
import re
import secrets
import socket
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote

from edit3r.contract.command import Command
from edit3r.contract.errors import InputError

ROOT_PATH = re.compile(r"(/[\w.~-]+)*")
LOCAL = ("127.0.0.1", "::1")


class AppCommand(Command):
    """Edit in the browser: drop photos, click the object, say what to change, see it in 3D."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        about = "photos to begin with; more can be dropped in the browser"
        add("photos", nargs="*", metavar="PHOTO|FOLDER", help=about)
        about = "where everything is kept (default edit3r-jobs)"
        add("--jobs", default="edit3r-jobs", metavar="FOLDER", help=about)
        about = "address to listen on; any but this machine's own asks for a token"
        add("--host", default=LOCAL[0], help=about)
        about = "port to listen on; default: 8090, or the next that is free"
        add("--port", type=int, metavar="N", help=about)
        about = (
            "path that a proxy serves the app under, such as /edit3r; asks for a token"
        )
        add("--root-path", default="", metavar="PATH", help=about)
        about = "print the address and open nothing"
        add("--no-browser", action="store_true", help=about)
        about = "longer side that photos are reduced to (default 512)"
        add("--size", type=int, default=512, metavar="N", help=about)

    def main(self, args: argparse.Namespace) -> int:
        from edit3r.kit.children import safe_path
        from edit3r.kit.photos.images import find_photos
        from edit3r.kit.photos.temporary import temporary_photos
        from edit3r_app.jobs import JobsFolder

        if not 8 <= args.size <= 8192 or not 0 <= (args.port or 0) < 65536:
            raise InputError(
                "--size: expected 8 to 8192 pixels; --port: expected 0 to 65535."
            )
        root = args.root_path.rstrip("/")
        if not ROOT_PATH.fullmatch(root):
            raise InputError(
                f"--root-path {args.root_path!r}: expected a path such as /edit3r."
            )
        host = LOCAL[0] if args.host == "localhost" else args.host
        from edit3r_app.server import serve
        from edit3r_app.uploads import copied

        start = "/"
        with temporary_photos():
            photos = find_photos(args.photos) if args.photos else []
            port = free_port(host, args.port)
            folder = JobsFolder(args.jobs)
            if photos:
                name = Path(args.photos[0]).resolve().stem
                start = f"/s/{quote(copied(folder, name, photos))}"
        token = None
        if host not in LOCAL or root:
            token = os.environ.get("EDIT3R_APP_TOKEN") or secrets.token_urlsafe(24)
        # No process that the app starts looks for modules in the current folder.
        with safe_path():
            serve(
                folder,
                host=host,
                port=port,
                token=token,
                root=root,
                size=args.size,
                start=start,
                show=not args.no_browser,
            )
        return 0


def free_port(host: str, wanted: int | None) -> int:
    """The wanted port, or without one 8090 or the next that is free; raises InputError."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for port in [*range(8090, 8190), 0] if wanted is None else [wanted]:
        with socket.socket(family) as probe, suppress(OSError):
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port))
            return probe.getsockname()[1]
    asked = f"--host {host}" if wanted is None else f"--host {host} --port {wanted}"
    raise InputError(
        f"{asked}: cannot be listened on; is another program there? Try another port."
    )

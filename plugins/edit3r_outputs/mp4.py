"""A flight around the scene as MP4: H.264 (ITU-T H.264), by PyAV."""

from pathlib import Path

import numpy as np
from pydantic import Field

import edit3r
from edit3r.contract.errors import InputError, MissingDependencyError
from edit3r.contract.interfaces import SceneToWrite, Writer

CODECS = ("libx264", "libopenh264", "h264")  # whichever this build of FFmpeg has
CRF = 20  # constant quality of libx264; 18 can hardly be told from the frames


class Mp4Writer(Writer):
    """The flight as a file that every player knows."""

    needs = ("frames",)

    class Settings(edit3r.Settings):
        fps: int = Field(18, ge=1, le=240)
        """frames per second"""

    settings: Settings

    def write(self, path: Path, scene: SceneToWrite) -> None:
        import av

        assert scene.frames is not None  # it is needed
        codec = next((one for one in CODECS if one in av.codecs_available), None)
        if codec is None:
            raise MissingDependencyError(
                "this PyAV cannot encode H.264; install the one from PyPI: pip install av"
            )
        with av.open(str(path), "w", format="mp4") as file:
            stream = None
            for frame in scene.frames():
                pixels = _even(frame)
                if stream is None:
                    stream = file.add_stream(codec, rate=self.settings.fps)
                    stream.height, stream.width = pixels.shape[:2]
                    stream.pix_fmt = "yuv420p"  # what players and browsers read
                    # one thread: the same scene gives the same bytes
                    stream.options = {"crf": str(CRF), "threads": "1"}
                picture = av.VideoFrame.from_ndarray(pixels, format="rgb24")
                file.mux(stream.encode(picture))
            if stream is None:
                raise InputError(f"{path}: a video needs at least one frame.")
            file.mux(stream.encode())


def _even(pixels: np.ndarray) -> np.ndarray:
    """The picture with even sides, by leaving out a last row or column: colour is halved."""
    height, width = pixels.shape[:2]
    return np.ascontiguousarray(pixels[: height - height % 2, : width - width % 2])

"""A flight around the scene as MP4: H.264 (ITU-T H.264), by PyAV."""

from pathlib import Path

import numpy as np
from pydantic import Field

import edit3r
from edit3r.contract.errors import InputError, MissingDependencyError
from edit3r.contract.interfaces import SceneToWrite, Writer

CODECS = ("libx264", "libopenh264", "h264")  # whichever this build of FFmpeg has
BT709, LIMITED = 1, 1  # of ITU-T H.273 and FFmpeg; untagged, players guess by the size
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
        # with the index in front, a browser plays it before it has all of it
        fast = {"movflags": "faststart"}
        with av.open(str(path), "w", format="mp4", container_options=fast) as file:
            stream = None
            for frame in scene.frames():
                pixels = _even(frame)
                if stream is None:
                    stream = file.add_stream(codec, rate=self.settings.fps)
                    stream.height, stream.width = pixels.shape[:2]
                    stream.pix_fmt = "yuv420p"  # what players and browsers read
                    # one thread: the same scene gives the same bytes
                    stream.options = {"crf": str(CRF), "threads": "1"}
                    context = stream.codec_context
                    context.colorspace = context.color_primaries = context.color_trc = (
                        BT709
                    )
                    context.color_range = LIMITED
                picture = av.VideoFrame.from_ndarray(pixels, format="rgb24").reformat(
                    format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG"
                )
                file.mux(stream.encode(picture))
            if stream is None:
                raise InputError(f"{path}: a video needs at least one frame.")
            file.mux(stream.encode())


def _even(pixels: np.ndarray) -> np.ndarray:
    """The picture with even sides, a last row or column repeated: colour is halved."""
    height, width = pixels.shape[:2]
    return np.pad(pixels, ((0, height % 2), (0, width % 2), (0, 0)), "edge")

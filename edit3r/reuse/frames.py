"""Pictures of an edited scene from those of the scene before: only the part that can differ is drawn.

    earlier picture ------------------------------------------.
    changed Gaussians --> cells they may show in --.           +--> picture
                          all that may show there --> drawn --'

What is drawn is the same, bit for bit, as in a picture drawn whole: same camera, and of the Gaussians only those are
left out that show nowhere in the cells. The rest was drawn so before.
"""

import hashlib
from collections.abc import Callable, Iterator, Sequence

from edit3r_refiners.footprint import Footprint, Outlines, pixels_of
from edit3r_refiners.keep_outside_mask import VALUES, differing, same_structure

from edit3r.io.images import Pixels, decode_png, to_bytes
from edit3r.reporting import note
from edit3r.reuse.state import SceneState, frame_file
from edit3r.types import Cameras, Gaussians, Rendering

Render = Callable[[Gaussians, Cameras], Rendering]
MOST = 0.35  # of the Gaussians; telling which to leave out takes longer than drawing half of them


def earlier_frames(earlier: SceneState, rasterizer: str) -> list[bytes] | None:
    """The files of the earlier run's frames; None unless they are as it left them and show its whole scene.

    `rasterizer` is the identity of what would draw them.
    """
    if not earlier.drawn.whole or earlier.drawn.rasterizer != rasterizer:
        return None
    files = [frame_file(earlier.root / "renders", index) for index in range(earlier.path.count)]
    contents = [file.read_bytes() if file.is_file() else b"" for file in files]
    return contents if [hash_of(content) for content in contents] == list(earlier.drawn.frames) else None


def hash_of(content: bytes) -> str:
    """Of a frame's file."""
    return hashlib.blake2b(content, digest_size=16).hexdigest()


def redraw(
    before: Sequence[bytes],
    changed: Gaussians,
    gaussians: Gaussians,
    cameras: Cameras,
    footprint: Footprint,
    render: Render,
) -> Iterator[Pixels]:
    """One picture of `gaussians` per camera: the files `before`, drawn anew where any of `changed` may show.

    From the first picture on of which so little stays that nothing is gained, all are drawn whole.
    """
    new, everything, partly = Outlines(changed, footprint), Outlines(gaussians, footprint), True
    for index, content in enumerate(before):
        camera = cameras.select([index])
        if partly:
            cells = new.cells(cameras, index)
            near = everything.meeting(cameras, index, cells)
            partly = len(near) <= MOST * gaussians.count
        if not partly:
            yield to_bytes(render(gaussians, camera).images[0, 0])
            continue
        picture = decode_png(content)
        if cells.any():
            drawn = pixels_of(cells, cameras.image_size).cpu().numpy()
            picture[drawn] = to_bytes(render(gaussians.select(near), camera).images[0, 0])[drawn]
        note("reuse.frames", index + 1)
        yield picture


def changed_between(before: Gaussians, after: Gaussians) -> Gaussians | None:
    """Gaussians that show wherever pictures of the scenes can differ; None: cannot be told (another number or order).

    Of two that differ in colour or opacity alone, one will do.
    """
    if not same_structure(before, after):
        return None
    differs, moved = (differing(before, after, names).nonzero()[:, 0] for names in (VALUES, ("means", "scales")))
    return Gaussians.cat((before.select(moved), after.select(differs)))
